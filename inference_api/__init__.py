"""The HTTP service that answers ``POST /sample``: pictures in, configurations out."""
