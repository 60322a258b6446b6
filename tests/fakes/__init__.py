"""In-memory twins of the adapters, for unit tests only."""
