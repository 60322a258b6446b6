"""OMPL's planners and the project's own, with samples from outside.

``ompl_planner`` solves; ``cspace_client.ompl`` hands samples to OMPL, in set-ups of other people as well;
``sampled_prm`` and ``sampled_connect`` draw from them themselves; ``samples`` puts them along the way;
``path_check`` judges.
"""
