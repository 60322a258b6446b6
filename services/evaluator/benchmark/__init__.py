"""The planning benchmark: many ways to solve the same problems with the same seeds, measured run by run.

In the order of a benchmark: ``runs`` says what is compared, measures and keeps it; ``summary`` reduces the
runs to numbers with intervals; ``telling`` writes tables, figures and files; ``job`` does all three,
``command`` asks for it.
"""
