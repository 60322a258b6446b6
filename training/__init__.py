"""Learning: data sets, clusters, trials, and the bundle that comes out of them."""
