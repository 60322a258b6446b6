"""The models that answer: followed in the registry, downloaded, verified, opened and cached."""
