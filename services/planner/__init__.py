"""Motion planning with OMPL, fed by configurations from the inference API or from a bundle."""
