"""The planning benchmark: many ways to solve the same problems with the same seeds, measured run by run.

In the order of a benchmark: ``arms`` says what is compared and ``setting`` under which limits; ``sources``
are the learned samplers; ``measure`` runs one problem with all its arms, in the processes of ``spread`` or
on a ``cluster``; ``store`` keeps the runs; ``break_even``, ``summary`` and ``convergence`` reduce them; the
rest tells.
"""
