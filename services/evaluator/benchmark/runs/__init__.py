"""What the benchmark compares, under which limits, and the runs themselves.

``arms`` says what is compared and ``setting`` under which limits; ``sources`` are the learned samplers;
``measure`` runs one problem with all its arms, in the processes of ``spread`` or on a ``cluster``; ``store``
keeps the runs.
"""
