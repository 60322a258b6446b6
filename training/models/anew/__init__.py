"""Networks that a bundle's graphs were exported of, by the weights that these hold."""
