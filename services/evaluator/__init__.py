"""Evaluates samplers: reconstruction of the free space, its topology, and what a planner gains from it.

``measures`` ask samplers for configurations and measure them; ``statistics`` adds the uncertainty;
``evaluation`` is the job with its gate and report, ``benchmark`` the planning benchmark; ``cluster``
spreads the work.
"""
