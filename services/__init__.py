"""The outside world, one folder each: registry, planner, evaluator, and the processes of this machine."""
