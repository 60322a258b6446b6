"""What clients ask an inference API, and how its answers are read."""
