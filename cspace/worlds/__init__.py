"""Worlds: what a robot is, how it is seen, and what counts as a collision; one folder each."""
