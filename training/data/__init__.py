"""Data sets: generation by Ray tasks, import of own data."""
