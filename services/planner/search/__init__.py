"""OMPL's planners and the project's own, with samples from outside.

``ompl_planner`` solves; ``samples`` and ``goal_region`` hand samples to OMPL, ``feeding`` to set-ups
of other people; ``sampled_prm`` and ``sampled_connect`` draw from them themselves; ``sample_order`` puts them
along the way; ``path_check`` judges.
"""
