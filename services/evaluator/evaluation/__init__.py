"""An evaluation: its units of work, its gate, its record and its report.

``units`` are what is measured, ``gate`` decides, ``report`` presents it, ``job`` records.
"""
