"""A grid of training jobs as one submission: its points, its record, its tables."""
