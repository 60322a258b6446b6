"""The planning benchmark: arms solve the same problems with the same seeds, measured run by run.

``samples`` and ``plans`` measure, ``runs`` keeps a long table, ``summary`` reduces it to figures with
intervals, ``report`` and ``figures`` present them, ``job`` does all three.
"""
