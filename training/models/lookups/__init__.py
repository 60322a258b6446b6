"""Features of pictures at projected points."""
