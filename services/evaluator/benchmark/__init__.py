"""The planning benchmark: variants solve the same problems with the same seeds, measured run by run."""
