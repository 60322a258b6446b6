"""Judges samplers: reconstruction of the free space, its topology, and what a planner gains from it.

In the order of an evaluation: ``samplers`` are asked for configurations; ``reconstruction``, ``topology`` and
``planning`` measure them; ``statistics`` adds the uncertainty; ``gate`` decides; ``report`` tells; ``job``
records.
"""
