"""The benchmark of plans in scenes that pictures show in part: without exact checks, and with them.

``setting`` says what is compared on which problems, ``record`` what is kept of it, ``planners`` are the
models that plan; ``measure`` runs a problem; ``unchecked`` and ``checked`` reduce the runs to the two tables,
``rows``, ``figure`` and ``report`` tell them, ``files`` writes them; ``job`` does all of it,
``command`` asks for it.
"""
