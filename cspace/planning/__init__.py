"""Planning by what a model predicts of a scene that it knows from pictures."""
