"""Checks, grids of free cells, ways through them and problems of an arm among discs."""
