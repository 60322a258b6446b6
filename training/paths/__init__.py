"""From a data set to a bundle of path samples, trained or searched."""
