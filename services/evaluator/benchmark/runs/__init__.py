"""What the benchmark compares, under which limits, and the runs themselves."""
