"""Many trials, nodes and runs."""
