"""Robots of the spatial world, made from the descriptions that others keep of them."""
