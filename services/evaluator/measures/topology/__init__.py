"""Topology of point clouds: the geometry score and its twin of the complement."""
