"""An evaluation: its units of work, its gate, its record and its report.

``units`` are measured by ``execution``, ``gate`` decides, ``report`` tells, ``job`` records.
"""
