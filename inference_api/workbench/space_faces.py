"""Obstacles as flat pieces that a page can paint one over the other, the farthest first."""

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

# Large faces are cut, so that the order of their middles is the order in which they hide each other.
_PIECE_M, _MOST_PIECES = 0.22, 12
# Of a cylinder.
_SIDES = 14
_Points = NDArray[np.float64]


class Face(BaseModel):
    """A flat piece of an obstacle.

    Args:
        points: its corners in a round, m.
        normal: leads outwards.
    """

    points: list[list[float]]
    normal: list[float]


def faces_of(obstacles: dict[str, Any]) -> list[Face]:
    """The faces of boxes and cylinders as a scene tells them."""
    boxes = [_box(np.array(one["pose"]), np.array(one["half_m"])) for one in obstacles["boxes"]]
    cylinders = [
        _cylinder(np.array(one["pose"]), one["radius_m"], one["half_length_m"])
        for one in obstacles["cylinders"]
    ]
    return [face for faces in boxes + cylinders for face in faces]


def _box(pose: _Points, half_m: _Points) -> list[Face]:
    faces = []
    for axis, sign in product(range(3), (-1.0, 1.0)):
        sides = [(axis + 1) % 3, (axis + 2) % 3]
        rows, columns = (min(_MOST_PIECES, int(np.ceil(2.0 * half_m[side] / _PIECE_M))) for side in sides)
        for row, column in product(range(rows), range(columns)):
            # -1 to 1 along each of the axes.
            corners = np.full((4, 3), sign)
            corners[:, sides[0]] = 2.0 * (row + np.array([0, 1, 1, 0])) / rows - 1.0
            corners[:, sides[1]] = 2.0 * (column + np.array([0, 0, 1, 1])) / columns - 1.0
            faces.append(_face(pose, corners * half_m, sign * np.eye(3)[axis]))
    return faces


def _cylinder(pose: _Points, radius_m: float, half_length_m: float) -> list[Face]:
    turns = 2.0 * np.pi * np.arange(_SIDES + 1) / _SIDES
    rim = np.stack([radius_m * np.cos(turns), radius_m * np.sin(turns), np.zeros_like(turns)], axis=1)
    upwards = np.array([0.0, 0.0, half_length_m])
    low, high = rim - upwards, rim + upwards
    around = [
        _face(pose, np.stack([low[at], low[at + 1], high[at + 1], high[at]]), rim[at] + rim[at + 1])
        for at in range(_SIDES)
    ]
    ends = ((low, -upwards), (high, upwards))
    return around + [_face(pose, end[:-1], normal) for end, normal in ends]


def _face(pose: _Points, points: _Points, normal: _Points) -> Face:
    """In the robot's base, to the tenth of a millimetre."""
    turned = pose[:3, :3] @ (normal / np.linalg.norm(normal))
    placed = points @ pose[:3, :3].T + pose[:3, 3]
    return Face(points=placed.round(4).tolist(), normal=turned.round(4).tolist())
