"""Motion planning with OMPL, fed by configurations from the inference API.

``sources`` fetch a batch over HTTP or draw it in this process; ``search`` hands it to OMPL's planners and to
the project's own; ``planning`` joins both; ``drawing`` shows what happened, ``report`` tells it.
"""
