"""Furniture by chance, what stands on it, and the settings by which scenes are drawn. NumPy alone."""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.files import Record, Share, Span, validated
from cspace.worlds.spatial.obstacles import MAX_OBSTACLES, Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import MAX_PLACE_M, Vector, make_pose, pose_of, turned, vector


@validated(ScenarioError)
class GoalRegion(Record):
    """Where goals of the hand are: places within a box, and the way in."""

    box: Box
    approach: Vector

    def draw(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Uniform places in the box, (count, 3) m in the base frame."""
        pose, half = np.array(self.box.pose), np.array(self.box.half_m)
        return np.asarray(rng.uniform(-half, half, (count, 3)) @ pose[:3, :3].T + pose[:3, 3])


@validated(ScenarioError)
class Layout(Record):
    """A scene of a family."""

    family: str
    obstacles: Obstacles
    regions: tuple[GoalRegion, ...]
    focus: Vector  # what cameras look at, m


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of furniture with what stands on it, in any frame."""

    shapes: tuple[Box | Cylinder, ...]
    regions: tuple[GoalRegion, ...]

    def moved(self, pose: ArrayLike) -> "Piece":
        """The same in another frame, by the pose (4, 4) of this frame in that one."""
        by = np.asarray(pose, dtype=np.float64)
        regions = tuple(
            GoalRegion(_moved(one.box, by), vector(by[:3, :3] @ one.approach)) for one in self.regions
        )
        return Piece(tuple(_moved(shape, by) for shape in self.shapes), regions)

    def __add__(self, other: "Piece") -> "Piece":
        return Piece(self.shapes + other.shapes, self.regions + other.regions)


_Shape = TypeVar("_Shape", bound=Box | Cylinder)


def _moved(shape: _Shape, by: NDArray[np.float64]) -> _Shape:
    return replace(shape, pose=pose_of(by @ np.array(shape.pose)))


Range = tuple[float, float]
_THINNEST_M = 0.004
_LONGEST_M = 10.0
# Of counts, of heights, which may be below the base, and of sizes.
_Counts = Span[Annotated[int, Field(ge=0, le=MAX_OBSTACLES)]]
_Heights = Span[Annotated[float, Field(ge=-_LONGEST_M, le=_LONGEST_M)]]
_Sizes = Span[Annotated[float, Field(ge=_THINNEST_M, le=_LONGEST_M)]]


def block(*spans: Range, pose: NDArray[np.float64] | None = None) -> Box:
    """A box by its extents along x, y, z of a frame, m, at least 4 mm thick; ``pose``: of that frame."""
    ends = np.array(spans, dtype=np.float64)
    placed = make_pose(np.eye(3), ends.mean(axis=1))
    half = np.maximum((ends[:, 1] - ends[:, 0]) / 2, _THINNEST_M / 2)
    return Box(pose_of(placed if pose is None else pose @ placed), vector(half))


def within(span: Range, margin: float) -> Range:
    """An extent without a margin at either end; its middle where nothing would remain."""
    middle = (span[0] + span[1]) / 2
    return min(span[0] + margin, middle), max(span[1] - margin, middle)


def standing(
    rng: np.random.Generator, count: int, x: Range, y: Range, ground_m: float, tallest_m: float
) -> tuple[Box | Cylinder, ...]:
    """Upright boxes, plates and cylinders on the ground of a rectangle, none that has less than 5 cm."""
    found: list[Box | Cylinder] = []
    for _ in range(count if tallest_m >= 0.05 else 0):
        high = rng.uniform(0.04, min(tallest_m, 0.45))
        place = make_pose(
            turned(rng.uniform(-np.pi, np.pi)), (rng.uniform(*x), rng.uniform(*y), ground_m + high / 2)
        )
        if rng.random() < 0.5:
            found.append(Cylinder(pose_of(place), float(rng.uniform(0.02, 0.08)), high / 2))
        else:
            thin = rng.random() < 0.3
            half = (rng.uniform(0.02, 0.13), rng.uniform(0.005, 0.02 if thin else 0.13), high / 2)
            found.append(Box(pose_of(place), vector(half)))
    return tuple(found)


def floating(
    rng: np.random.Generator, count: int, reach_m: Range, bearing_rad: float
) -> tuple[Box | Cylinder, ...]:
    """Boxes and cylinders of any size and turn, anywhere to either side of the robot."""
    found: list[Box | Cylinder] = []
    for _ in range(count):
        bearing, away = rng.uniform(-bearing_rad, bearing_rad), rng.uniform(*reach_m)
        turn = turned(
            *rng.uniform(-np.pi, np.pi, 3) * ((1.0, 0.5, 0.5) if rng.random() < 0.5 else (1.0, 0.0, 0.0))
        )
        place = (away * np.cos(bearing), away * np.sin(bearing), rng.uniform(-0.3, 1.1))
        pose = pose_of(make_pose(turn, place))
        half = np.exp(rng.uniform(np.log(0.015), np.log(0.2), 3))
        if rng.random() < 0.2:
            half[2] = rng.uniform(0.3, 0.8)
            half[:2] = np.minimum(half[:2], 0.05)
        if rng.random() < 0.4:
            found.append(Cylinder(pose, float(half[0]), float(half[2])))
        else:
            found.append(Box(pose, vector(half)))
    return tuple(found)


# What a hand needs beside a board.
_MARGIN_M = 0.04
_LEVEL = np.eye(3)


@validated(ScenarioError)
class Shelves:
    """Boards above each other, with or without sides, back and divider; lengths in m, chances as shares."""

    width_m: _Sizes = (0.45, 1.3)
    depth_m: _Sizes = (0.2, 1.25)
    gap_m: _Sizes = (0.2, 0.45)
    boards: _Counts = (2, 6)
    lowest_m: _Heights = (-0.5, 0.45)
    thickness_m: _Sizes = (0.008, 0.05)
    back: Share = 0.5
    walls: Share = 0.6
    divider: Share = 0.3
    objects: _Counts = (0, 4)

    def __post_init__(self) -> None:
        if self.boards[0] < 2:
            raise ScenarioError("a shelf has too few boards", expected="2 or more", got=str(self.boards[0]))

    def draw(self, rng: np.random.Generator) -> Piece:
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


@validated(ScenarioError)
class Tables:
    """A board on four legs, with objects on it; goals are above it, from two sides, or below it too."""

    width_m: _Sizes = (0.5, 2.0)
    depth_m: _Sizes = (0.4, 1.3)
    height_m: _Heights = (-0.25, 0.45)
    high_m: _Heights = (0.2, 0.75)
    thickness_m: _Sizes = (0.01, 0.06)
    leg_m: _Sizes = (0.03, 0.1)
    leg_length_m: _Sizes = (0.4, 0.8)
    bar: Share = 0.3
    objects: _Counts = (1, 12)

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


@validated(ScenarioError)
class Bins:
    """A box of five walls, open upwards, to the front or to a side, often with a lid that is half open."""

    side_m: _Sizes = (0.25, 0.8)
    thickness_m: _Sizes = (0.008, 0.045)
    lowest_m: _Heights = (-0.55, 0.4)
    lid: Share = 0.7
    lid_rad: _Sizes = (0.3, 1.9)
    lower_wall: Share = 0.4
    objects: _Counts = (0, 4)

    def draw(self, rng: np.random.Generator) -> Piece:
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


@validated(ScenarioError)
class Cages:
    """A plate with walls, roof and front of boards, bars or grids, the front wide enough for a hand."""

    side_m: _Sizes = (0.35, 0.9)
    thickness_m: _Sizes = (0.008, 0.045)
    lowest_m: _Heights = (-0.3, 0.45)
    spacing_m: _Sizes = (0.08, 0.25)
    front_m: _Sizes = (0.2, 0.45)
    objects: _Counts = (0, 3)
    # Chance that all faces but the front are drawn anew, most of them solid, and the front has single bars.
    solid: Annotated[Share, Field(exclude_if=lambda share: share == 0.0)] = 0.0

    def draw(self, rng: np.random.Generator) -> Piece:
        half, thick, low = (
            rng.uniform(*self.side_m, 3) / 2,
            rng.uniform(*self.thickness_m),
            rng.uniform(*self.lowest_m),
        )
        shapes: list[Box | Cylinder] = [_wall(half, thick, 2, -1)]
        # No draw where it is not asked for: scenes of a seed stay what they were.
        solid = bool(self.solid) and bool(rng.random() < self.solid)
        for axis, side in ((0, 1), (1, -1), (1, 1), (2, 1)):
            kind = int(rng.integers(5))
            if solid and rng.random() < 0.75:
                kind = 0
            if kind == 0:
                shapes.append(_wall(half, thick, axis, side))
            elif kind < 4:
                shapes += _bars(half, thick, axis, side, rng.uniform(*self.spacing_m), kind)
        if solid:
            shapes += _single_bars(rng, half, thick, int(rng.integers(0, 4)))
        else:
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


def _single_bars(rng: np.random.Generator, half: NDArray[np.float64], thick: float, count: int) -> list[Box]:
    """Bars of the front, each at a place of its own, all level or all upright."""
    across = int(rng.integers(1, 3))
    found = []
    for place in rng.uniform(-half[across], half[across], count):
        spans = [(-one, one) for one in half]
        spans[0] = (-half[0] - thick / 2, -half[0] + thick / 2)
        spans[across] = (place - thick / 2, place + thick / 2)
        found.append(block(*spans))
    return found


def _lid(half: NDArray[np.float64], thick: float, edge: int, angle_rad: float) -> Box:
    """A board that lay on the opening, turned up by an angle about one of its four edges."""
    axis, side = edge // 2, 1.0 if edge % 2 else -1.0
    hinge, out = np.array([0.0, 0.0, half[2]]), np.zeros(3)
    hinge[axis], out[axis] = side * half[axis], -side * half[axis]
    turn = turned(0.0, side * angle_rad) if axis == 0 else turned(0.0, 0.0, -side * angle_rad)
    size = (half[0], half[1], thick / 2)
    return block(*((-one, one) for one in size), pose=make_pose(turn, hinge + turn @ out))


FAMILIES = ("shelf", "table", "under_table", "bin", "cage", "clutter", "mixture")


@validated(ScenarioError)
class SpatialScenes(Record):
    """Which scenes are drawn, and how wide."""

    # How often each family of :data:`FAMILIES` is drawn, in their order; they need not sum to 1
    shares: Annotated[tuple[Share, ...], Field(min_length=len(FAMILIES), max_length=len(FAMILIES))] = (
        0.26,
        0.12,
        0.12,
        0.2,
        0.14,
        0.06,
        0.1,
    )
    bearing_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 115.0
    distance_m: Span[Annotated[float, Field(ge=0.0, lt=MAX_PLACE_M / 2.0)]] = (0.2, 0.7)
    yaw_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 35.0
    stray: Share = 0.25
    strays: _Counts = (1, 8)
    floor: Share = 0.4
    wall: Share = 0.15
    # Share of scenes in which the arm stands on a table or block that ends at its base's level
    mounted: Annotated[Share, Field(exclude_if=lambda share: share == 0.0)] = 0.0
    shoulder_m: float = 0.333
    reach_m: float = 0.9  # a region counts if it has a free place no farther than this from the shoulder
    room_m: Annotated[float, Field(ge=0.0)] = 0.04
    base_m: Annotated[Vector, Field(exclude_if=lambda place: not any(place))] = (0.0, 0.0, 0.0)
    shelves: Shelves = field(default_factory=Shelves)
    tables: Tables = field(default_factory=Tables)
    bins: Bins = field(default_factory=Bins)
    cages: Cages = field(default_factory=Cages)

    def __post_init__(self) -> None:
        if self.room_m >= self.reach_m or not any(self.shares):
            raise ScenarioError(
                "the families of scenes do not fit", expected="a share above 0, and a reach beyond the room"
            )
