"""Checks, ways and problems of an arm among obstacles, and the judge by meshes."""
