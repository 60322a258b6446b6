"""The joint space as networks have it."""
