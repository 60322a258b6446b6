"""Evaluates samplers: how well they reconstruct the free space, its topology, and what a planner gains.

``scenes`` and ``measure`` ask samplers and apply the ``metrics``; ``evaluation`` makes estimates of the values;
``gate`` decides; ``job`` is all of it for a registered version. ``benchmark`` is the planning benchmark.
"""
