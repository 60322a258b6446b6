"""From a data set to a bundle of configurations: clusters, local trials, the global model."""
