"""Registered models: the port, and MLflow's adapter."""
