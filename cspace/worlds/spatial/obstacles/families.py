"""Families of scenes that arms meet: what stands where, by split, seed and index.

Pieces stand all round the arm, none in the column of its base, and in every scene a hand reaches something.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.splits import Split, scenario_rng
from cspace.worlds.spatial.obstacles.layout import GoalRegion, Layout, Piece
from cspace.worlds.spatial.obstacles.objects import block, floating
from cspace.worlds.spatial.obstacles.scenes import FAMILIES, SpatialScenes
from cspace.worlds.spatial.obstacles.shapes import Box, Cylinder, Obstacles
from cspace.worlds.spatial.obstacles.signed_distance import clearance_m, distance_m
from cspace.worlds.spatial.poses import make_pose, turned

_MAX_DRAWS = 300
# The column that the arm's base and shoulder turn in: balls above each other.
_COLUMN_M = np.array([[(0.0, 0.0, z) for z in (0.1, 0.2, 0.3, 0.4)]])
_COLUMN_RADIUS_M = 0.15
_PLACES = 32


def draw_layout(
    scenes: SpatialScenes, split: Split, seed: int, index: int, family: str | None = None
) -> Layout:
    """The scene of a split, a seed and an index; of one family where it is named.

    Raises:
        ScenarioError: there is no such family, or none of its scenes fits the settings.
    """
    if family is not None and family not in FAMILIES:
        raise ScenarioError(
            "the family of scenes is unknown", expected=f"one of {', '.join(FAMILIES)}", got=family[:200]
        )
    rng = scenario_rng(split, seed, index)
    shares = np.array(scenes.shares) / sum(scenes.shares)
    drawn = FAMILIES[int(rng.choice(len(FAMILIES), p=shares))]
    name = drawn if family is None else family
    for _ in range(_MAX_DRAWS):
        found = _attempt(scenes, rng, name)
        if found is not None:
            return found
    raise ScenarioError(f"no scene of the family {name} fits its settings", got=str(scenes)[:200])


def _attempt(scenes: SpatialScenes, rng: np.random.Generator, family: str) -> Layout | None:
    """A scene, or None where the base stands in something or the hand reaches nothing."""
    bearing = np.radians(rng.uniform(-scenes.bearing_deg, scenes.bearing_deg))
    pieces = _pieces(scenes, rng, family, bearing)
    if not _spares_base(Obstacles.of(pieces.shapes)):
        return None
    shapes = [*pieces.shapes, *_surroundings(scenes, rng, family, bearing, pieces.regions)]
    obstacles = Obstacles.of(shapes)
    regions = tuple(one for one in pieces.regions if _is_reached(scenes, rng, one, obstacles))
    if not regions:
        return None
    centres = np.array([[row[3] for row in one.box.pose[:3]] for one in regions])
    focus = centres[int(rng.integers(len(centres)))]
    return Layout(family, obstacles, regions, (float(focus[0]), float(focus[1]), float(focus[2])))


def _pieces(scenes: SpatialScenes, rng: np.random.Generator, family: str, bearing: float) -> Piece:
    if family == "clutter":
        return Piece((), tuple(_open_places(scenes, rng)))
    if family != "mixture":
        return _placed(scenes, rng, _furniture(scenes, rng, family), bearing)
    # Two or three in turn round the arm, at least 75 degrees from each other.
    found, step = Piece((), ()), np.radians(rng.uniform(75.0, 115.0)) * rng.choice((-1.0, 1.0))
    for place in range(int(rng.integers(2, 4))):
        other = FAMILIES[int(rng.integers(5))]
        found += _placed(scenes, rng, _furniture(scenes, rng, other), bearing + place * step)
    return found


def _furniture(scenes: SpatialScenes, rng: np.random.Generator, family: str) -> Piece:
    makers: Mapping[str, Callable[[], Piece]] = {
        "shelf": lambda: scenes.shelves.draw(rng),
        "table": lambda: scenes.tables.draw(rng, under=False),
        "under_table": lambda: scenes.tables.draw(rng, under=True),
        "bin": lambda: scenes.bins.draw(rng),
        "cage": lambda: scenes.cages.draw(rng),
    }
    return makers[family]()


def _placed(scenes: SpatialScenes, rng: np.random.Generator, piece: Piece, bearing: float) -> Piece:
    away = rng.uniform(*scenes.distance_m)
    yaw = bearing + np.radians(rng.uniform(-scenes.yaw_deg, scenes.yaw_deg))
    return piece.moved(make_pose(turned(yaw), (away * np.cos(bearing), away * np.sin(bearing), 0.0)))


def _open_places(scenes: SpatialScenes, rng: np.random.Generator) -> list[GoalRegion]:
    """Cubes of 30 cm all round, into which a hand comes from above or from the base."""
    found = []
    for _ in range(3):
        bearing, away = (
            np.radians(rng.uniform(-scenes.bearing_deg, scenes.bearing_deg)),
            rng.uniform(0.35, 0.7),
        )
        ahead = (float(np.cos(bearing)), float(np.sin(bearing)), 0.0)
        place = make_pose(turned(bearing), (away * ahead[0], away * ahead[1], rng.uniform(0.1, 0.7)))
        cube = block((-0.15, 0.15), (-0.15, 0.15), (-0.15, 0.15), pose=place)
        found.append(GoalRegion(cube, ahead if rng.random() < 0.5 else (0.0, 0.0, -1.0)))
    return found


def _surroundings(
    scenes: SpatialScenes,
    rng: np.random.Generator,
    family: str,
    bearing: float,
    regions: tuple[GoalRegion, ...],
) -> list[Box | Cylinder]:
    """Loose things, a floor below all goals, and a wall behind the arm; none in the base's column."""
    found: list[Box | Cylinder] = []
    if family == "clutter":
        found += floating(rng, int(rng.integers(6, 30)), (0.3, 1.2), np.radians(scenes.bearing_deg + 30.0))
    elif family == "mixture" or rng.random() < scenes.stray:
        count = int(rng.integers(*scenes.strays, endpoint=True))
        found += floating(rng, count, (0.3, 1.3), np.radians(scenes.bearing_deg + 30.0))
    if rng.random() < scenes.floor:
        low = min((_lowest(one) for one in regions), default=0.0)
        top = min(-0.06, low - 0.05) - rng.uniform(0.0, 0.6) * (rng.random() < 0.5)
        found.append(block((-1.5, 1.5), (-1.5, 1.5), (top - 0.02, top)))
    if rng.random() < scenes.wall:
        side = bearing + np.pi + np.radians(rng.uniform(-50.0, 50.0))
        away, turn = rng.uniform(0.3, 0.9), make_pose(turned(side), (0.0, 0.0, 0.0))
        found.append(block((away, away + 0.1), (-1.2, 1.2), (-0.8, 1.4), pose=turn))
    return [one for one in found if _spares_base(Obstacles.of((one,)))]


def _is_reached(
    scenes: SpatialScenes, rng: np.random.Generator, region: GoalRegion, obstacles: Obstacles
) -> bool:
    places = region.draw(rng, _PLACES)
    near = np.linalg.norm(places - (0.0, 0.0, scenes.shoulder_m), axis=1) <= scenes.reach_m
    free = distance_m(obstacles, places) >= scenes.room_m
    return bool((near & free & _off_base(places)).any())


def base_clearance_m(obstacles: Obstacles) -> float:
    """Signed distance between the obstacles and the column in which the arm's base and shoulder stand, m."""
    return float(clearance_m(obstacles, _COLUMN_M, np.full(_COLUMN_M.shape[1], _COLUMN_RADIUS_M))[0])


def _spares_base(obstacles: Obstacles) -> bool:
    return base_clearance_m(obstacles) > 0.0


def _off_base(places: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.hypot(places[:, 0], places[:, 1]) >= 2.0 * _COLUMN_RADIUS_M)


def _lowest(region: GoalRegion) -> float:
    pose, half = np.array(region.box.pose), np.array(region.box.half_m)
    return float(pose[2, 3] - np.abs(pose[2, :3]) @ half)
