"""Where a bundle's samples come from: its generator's graph, or ways that are searched for."""
