"""Ways through a map of free cells."""
