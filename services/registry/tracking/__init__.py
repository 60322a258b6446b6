"""Tracked runs: the port, MLflow's adapter, and what waits while MLflow is away."""
