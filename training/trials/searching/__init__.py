"""Trials of a hyperparameter search."""
