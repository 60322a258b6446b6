"""Learning: data sets, clusters, trials, and the bundle that comes out of them.

The commands lie here; ``clusters`` and ``paths`` are the two jobs, over ``trials``, ``models``, ``jobs``,
``config`` and ``datasets``.
"""
