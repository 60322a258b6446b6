"""Furniture by chance, each piece in a frame of its own: x away from the robot, z up, the front at x = 0.

Heights are those of the base frame: a piece is placed by turning and shifting it on the ground.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.strict_json import settle
from cspace.worlds.spatial.obstacles.layout import GoalRegion, Piece
from cspace.worlds.spatial.obstacles.objects import Range, block, check_ranges, standing, within
from cspace.worlds.spatial.obstacles.shapes import Box, Cylinder
from cspace.worlds.spatial.poses import make_pose, turned

# What a hand needs beside a board.
_MARGIN_M = 0.04
_LEVEL = np.eye(3)


@dataclass(frozen=True, slots=True)
class Shelves:
    """Boards above each other, with or without sides, back and divider; lengths in m, chances as shares."""

    width_m: Range = (0.45, 1.3)
    depth_m: Range = (0.2, 1.25)
    gap_m: Range = (0.2, 0.45)
    boards: tuple[int, int] = (2, 6)
    lowest_m: Range = (-0.5, 0.45)
    thickness_m: Range = (0.008, 0.05)
    back: float = 0.5
    walls: float = 0.6
    divider: float = 0.3
    objects: tuple[int, int] = (0, 4)

    def __post_init__(self) -> None:
        settle(self)
        check_ranges(self)
        if self.boards[0] < 2:
            raise ScenarioError("a shelf has too few boards", expected="2 or more", got=str(self.boards[0]))

    def draw(self, rng: np.random.Generator) -> Piece:
        """A shelf."""
        width, depth, thick = (rng.uniform(*one) for one in (self.width_m, self.depth_m, self.thickness_m))
        gaps = rng.uniform(*self.gap_m, int(rng.integers(*self.boards, endpoint=True)) - 1)
        heights = rng.uniform(*self.lowest_m) + np.concatenate(([0.0], np.cumsum(gaps)))
        low, high = heights[0] - rng.uniform(0.0, 0.6) * (rng.random() < 0.5), heights[-1] + thick
        shapes: list[Box | Cylinder] = [
            block((0.0, depth), (-width / 2, width / 2), (z - thick / 2, z + thick / 2)) for z in heights
        ]
        shapes += self._frame(rng, (width, depth, thick), (low, high))
        regions = []
        for below, above in pairwise(heights):
            room = (below + thick / 2, above - thick / 2)
            inside = ((0.02, depth - 0.02), (-width / 2 + 0.02, width / 2 - 0.02))
            count = int(rng.integers(*self.objects, endpoint=True))
            shapes += standing(rng, count, *inside, room[0], room[1] - room[0] - 0.03)
            reached = ((-0.02, min(depth, 0.6) - _MARGIN_M), within(inside[1], _MARGIN_M))
            regions.append(GoalRegion(block(*reached, within(room, _MARGIN_M)), (1.0, 0.0, 0.0)))
        return Piece(tuple(shapes), tuple(regions))

    def _frame(
        self, rng: np.random.Generator, size: tuple[float, float, float], tall: Range
    ) -> list[Box | Cylinder]:
        (width, depth, thick), half = size, size[0] / 2
        found: list[Box | Cylinder] = []
        if rng.random() < self.walls:
            found += [block((0.0, depth), (y - thick / 2, y + thick / 2), tall) for y in (-half, half)]
        else:
            post = rng.uniform(0.02, 0.06)
            found += [
                block((x - post / 2, x + post / 2), (y - post / 2, y + post / 2), tall)
                for x in (0.0, depth)
                for y in (-half, half)
            ]
        if rng.random() < self.back:
            found.append(block((depth - thick / 2, depth + thick / 2), (-half, half), tall))
        if rng.random() < self.divider:
            y = rng.uniform(-0.25, 0.25) * width
            found.append(block((0.0, depth), (y - thick / 2, y + thick / 2), tall))
        return found


@dataclass(frozen=True, slots=True)
class Tables:
    """A board on four legs, with objects on it; goals are above it, from two sides, or below it too."""

    width_m: Range = (0.5, 2.0)
    depth_m: Range = (0.4, 1.3)
    height_m: Range = (-0.25, 0.45)
    high_m: Range = (0.2, 0.75)
    thickness_m: Range = (0.01, 0.06)
    leg_m: Range = (0.03, 0.1)
    leg_length_m: Range = (0.4, 0.8)
    bar: float = 0.3
    objects: tuple[int, int] = (1, 12)

    def __post_init__(self) -> None:
        settle(self)
        check_ranges(self)

    def draw(self, rng: np.random.Generator, *, under: bool) -> Piece:
        """A table; with ``under`` a higher one, and goals below its board, too."""
        width, depth, thick = (rng.uniform(*one) for one in (self.width_m, self.depth_m, self.thickness_m))
        leg, top = rng.uniform(*self.leg_m), rng.uniform(*(self.high_m if under else self.height_m))
        bottom, ground = top - thick, top - thick - rng.uniform(*self.leg_length_m)
        across = (-width / 2, width / 2)
        shapes: list[Box | Cylinder] = [block((0.0, depth), across, (bottom, top))]
        shapes += [
            block((x, x + leg), (y, y + leg), (ground, bottom))
            for x in (0.0, depth - leg)
            for y in (-width / 2, width / 2 - leg)
        ]
        if rng.random() < self.bar:
            z = rng.uniform(ground, bottom)
            shapes.append(block((depth - 0.7 * leg, depth - 0.3 * leg), across, (z - 0.02, z + 0.02)))
        count = int(rng.integers(*self.objects, endpoint=True))
        shapes += standing(rng, count, (0.02, depth - 0.02), within(across, 0.02), top, 0.4)
        reached = ((0.0, min(depth, 0.7)), within(across, leg + _MARGIN_M))
        above = block(*reached, (top + _MARGIN_M, top + 0.35))
        regions = [GoalRegion(above, (0.0, 0.0, -1.0)), GoalRegion(above, (1.0, 0.0, 0.0))]
        if under:
            below = block(*reached, (max(bottom - 0.45, ground), bottom - _MARGIN_M))
            regions.append(GoalRegion(below, (1.0, 0.0, 0.0)))
        return Piece(tuple(shapes), tuple(regions))


@dataclass(frozen=True, slots=True)
class Bins:
    """A box of five walls, open upwards, to the front or to a side, often with a lid that is half open."""

    side_m: Range = (0.25, 0.8)
    thickness_m: Range = (0.008, 0.045)
    lowest_m: Range = (-0.55, 0.4)
    lid: float = 0.7
    lid_rad: Range = (0.3, 1.9)
    lower_wall: float = 0.4
    objects: tuple[int, int] = (0, 4)

    def __post_init__(self) -> None:
        settle(self)
        check_ranges(self)

    def draw(self, rng: np.random.Generator) -> Piece:
        """A bin."""
        half, thick = rng.uniform(*self.side_m, 3) / 2, rng.uniform(*self.thickness_m)
        opening = _OPENINGS[int(rng.integers(len(_OPENINGS)))]
        shapes = [_wall(half, thick, 2, -1)]
        for axis in (0, 1):
            for side in (-1, 1):
                share = rng.uniform(0.4, 1.0) if rng.random() < self.lower_wall / 4 else 1.0
                shapes.append(_wall(half, thick, axis, side, share))
        if rng.random() < self.lid:
            shapes.append(_lid(half, thick, int(rng.integers(4)), rng.uniform(*self.lid_rad)))
        inside = tuple(within((-one, one), thick / 2 + 0.5 * _MARGIN_M) for one in half)
        region = GoalRegion(block(*inside[:2], (inside[2][0], half[2])), (0.0, 0.0, -1.0))
        extent = np.abs(opening) @ half
        turn = make_pose(opening, (extent[0], 0.0, rng.uniform(*self.lowest_m) + extent[2]))
        hollow = Piece(tuple(shapes), (region,)).moved(turn)
        room = within((turn[2, 3] - extent[2], turn[2, 3] + extent[2]), thick)
        count = int(rng.integers(*self.objects, endpoint=True))
        free = (within((0.0, 2 * extent[0]), thick), within((-extent[1], extent[1]), thick))
        return hollow + Piece(standing(rng, count, *free, room[0], 0.8 * (room[1] - room[0])), ())


@dataclass(frozen=True, slots=True)
class Cages:
    """A plate with walls, roof and front of boards, bars or grids, the front wide enough for a hand."""

    side_m: Range = (0.35, 0.9)
    thickness_m: Range = (0.008, 0.045)
    lowest_m: Range = (-0.3, 0.45)
    spacing_m: Range = (0.08, 0.25)
    front_m: Range = (0.2, 0.45)
    objects: tuple[int, int] = (0, 3)

    def __post_init__(self) -> None:
        settle(self)
        check_ranges(self)

    def draw(self, rng: np.random.Generator) -> Piece:
        """A cage."""
        half, thick, low = (
            rng.uniform(*self.side_m, 3) / 2,
            rng.uniform(*self.thickness_m),
            rng.uniform(*self.lowest_m),
        )
        shapes: list[Box | Cylinder] = [_wall(half, thick, 2, -1)]
        for axis, side in ((0, 1), (1, -1), (1, 1), (2, 1)):
            kind = int(rng.integers(5))
            if kind == 0:
                shapes.append(_wall(half, thick, axis, side))
            elif kind < 4:
                shapes += _bars(half, thick, axis, side, rng.uniform(*self.spacing_m), kind)
        front = int(rng.integers(1, 4))
        shapes += _bars(half, thick, 0, -1, rng.uniform(*self.front_m), front)
        inside = tuple(within((-one, one), thick / 2 + _MARGIN_M) for one in half)
        region = GoalRegion(block(*inside), (1.0, 0.0, 0.0))
        floor = -half[2] + thick / 2
        count = int(rng.integers(*self.objects, endpoint=True))
        shapes += standing(rng, count, inside[0], inside[1], floor, 0.6 * 2 * half[2])
        return Piece(tuple(shapes), (region,)).moved(make_pose(_LEVEL, (half[0], 0.0, low + half[2])))


# Rotations that turn what is open upwards to where it opens: up in half of all cases, else front or a side.
_OPENINGS = (
    _LEVEL,
    _LEVEL,
    _LEVEL,
    np.rint(turned(0.0, -np.pi / 2)),
    np.rint(turned(0.0, 0.0, -np.pi / 2)),
    np.rint(turned(0.0, 0.0, np.pi / 2)),
)


def _wall(half: NDArray[np.float64], thick: float, axis: int, side: int, share: float = 1.0) -> Box:
    """A face of a cuboid as a board; of an upright one only the lower share."""
    spans = [(-one, one) for one in half]
    spans[axis] = (side * half[axis] - thick / 2, side * half[axis] + thick / 2)
    if axis != 2:
        spans[2] = (-half[2], -half[2] + 2 * half[2] * share)
    return block(*spans)


def _bars(
    half: NDArray[np.float64], thick: float, axis: int, side: int, spacing: float, kind: int
) -> list[Box]:
    """A face of bars along one direction (1), the other (2) or both (3), the outermost at the edges."""
    others = [one for one in range(3) if one != axis]
    found = []
    for along, across in (others, others[::-1]):
        if not kind & (1 if along == others[0] else 2):
            continue
        count = max(2, int(2 * half[across] / spacing) + 1)
        for place in np.linspace(-half[across], half[across], count):
            spans = [(-one, one) for one in half]
            spans[axis] = (side * half[axis] - thick / 2, side * half[axis] + thick / 2)
            spans[across] = (place - thick / 2, place + thick / 2)
            found.append(block(*spans))
    return found


def _lid(half: NDArray[np.float64], thick: float, edge: int, angle_rad: float) -> Box:
    """A board that lay on the opening, turned up by an angle about one of its four edges."""
    axis, side = edge // 2, 1.0 if edge % 2 else -1.0
    hinge, out = np.array([0.0, 0.0, half[2]]), np.zeros(3)
    hinge[axis], out[axis] = side * half[axis], -side * half[axis]
    turn = turned(0.0, side * angle_rad) if axis == 0 else turned(0.0, 0.0, -side * angle_rad)
    size = (float(half[0]), float(half[1]), thick / 2)
    return block(*((-one, one) for one in size), pose=make_pose(turn, hinge + turn @ out))
