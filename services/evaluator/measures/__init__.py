"""What is measured of samplers: reconstruction, occupancy, topology, planning."""
