"""Evaluates samplers: the free space they reconstruct, its topology, and what a planner gains."""
