"""Colours and line widths of the planner's figures: obstacles grey in both spaces, one hue for each part."""

import numpy as np
from matplotlib.colors import to_hex, to_rgb

INK = "#2b2f36"
MUTED = "#6b7280"
OBSTACLE = "#d3cfc7"
START = "#1f6fb2"
GOAL = "#c0392b"
PATH = "#e08a1e"
LEARNED = "#1a9e8c"
TREE = "#8d97a8"


def between(share: float, tint: float) -> str:
    """A colour on the way from the start's to the goal's, lightened.

    Args:
        share: 0 at the start, 1 at the goal.
        tint: 0 for the full colour, 1 for white.
    """
    start, goal = np.array(to_rgb(START)), np.array(to_rgb(GOAL))
    full = start + share * (goal - start)
    return str(to_hex(full + tint * (1.0 - full)))
