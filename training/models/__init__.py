"""Networks, losses, their Lightning shells, checkpoints and the export to a bundle."""
