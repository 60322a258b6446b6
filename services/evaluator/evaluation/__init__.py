"""An evaluation: units of work, the gate, the record and the report."""
