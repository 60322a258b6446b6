"""Depth cameras: pictures, noise, where cameras stand, and what their pictures say of the space."""
