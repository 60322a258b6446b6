"""The models that answer: found in the registry, verified apart, loaded, kept."""
