"""OMPL's planners and the project's own, with samples from outside."""
