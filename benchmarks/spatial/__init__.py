"""What the spatial world takes on one core."""
