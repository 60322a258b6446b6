"""The guided run: start, train, evaluate, promote, serve, plan."""
