"""Jobs: runs and folders, trials on the cluster, what workers train, and where a model comes from."""
