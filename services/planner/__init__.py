"""Motion planning with OMPL, fed by configurations from the inference API.

``client`` requests a batch over HTTP, ``samples`` draws one in this process; ``ompl_planner`` and
``rrt_connect`` search with it; ``planning`` joins both; ``plotting`` shows the outcome.
"""
