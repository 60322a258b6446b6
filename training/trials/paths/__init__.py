"""Trials of path models."""
