"""Paths and configurations as pictures."""
