"""Planning in what a model believes of a scene that it knows by a picture."""
