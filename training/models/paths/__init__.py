"""Models of samples between a start and a goal."""
