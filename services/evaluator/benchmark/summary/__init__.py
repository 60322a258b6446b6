"""Runs reduced to numbers with intervals."""
