"""Scenes of the spatial world: what stands about an arm, who looks at it, and where the arm is meanwhile."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.simulator import Split, scenario_rng
from cspace.worlds.spatial.arm import SerialArm, ready_rad
from cspace.worlds.spatial.bodies import clearance_m, distance_m
from cspace.worlds.spatial.camera import DepthCamera, camera_place, looking, to_mm
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import (
    FAMILIES,
    Bins,
    Cages,
    GoalRegion,
    Layout,
    Piece,
    Shelves,
    SpatialScenes,
    block,
    floating,
    standing,
)
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import make_pose, turned, vector
from cspace.worlds.spatial.rendering import NOISE_MODELS, holed, render_depth
from cspace.worlds.spatial.sensor import CameraViews
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.world import SpatialWorld

_MAX_DRAWS = 300
# The column that the arm's base and shoulder turn in: balls above each other.
_COLUMN_M = np.array([[(0.0, 0.0, z) for z in (0.1, 0.2, 0.3, 0.4)]])
_COLUMN_RADIUS_M = 0.15
_PLACES = 32


def draw_layout(
    scenes: SpatialScenes, split: Split, seed: int, index: int, family: str | None = None
) -> Layout:
    """The scene of a split, a seed and an index; of one family where it is named."""
    if family is not None and family not in FAMILIES:
        raise ScenarioError(
            "the family of scenes is unknown", expected=f"one of {', '.join(FAMILIES)}", got=family[:200]
        )
    rng = scenario_rng(split, seed, index)
    shares = np.array(scenes.shares) / sum(scenes.shares)
    any_family = FAMILIES[int(rng.choice(len(FAMILIES), p=shares))]
    name = any_family if family is None else family
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
    if any(scenes.base_m):
        piece = Piece(tuple(shapes), regions).moved(make_pose(np.eye(3), scenes.base_m))
        obstacles, regions = Obstacles.of(piece.shapes), piece.regions
    centres = np.array([[row[3] for row in one.box.pose[:3]] for one in regions])
    focus = centres[int(rng.integers(len(centres)))]
    return Layout(family, obstacles, regions, vector(focus))


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
    if family in ("table", "under_table"):
        return scenes.tables.draw(rng, under=family == "under_table")
    others: dict[str, Shelves | Bins | Cages] = {
        "shelf": scenes.shelves,
        "bin": scenes.bins,
        "cage": scenes.cages,
    }
    return others[family].draw(rng)


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
        poses = ((np.array(one.box.pose), np.array(one.box.half_m)) for one in regions)
        low = min((float(pose[2, 3] - np.abs(pose[2, :3]) @ half) for pose, half in poses), default=0.0)
        top = min(-0.06, low - 0.05) - rng.uniform(0.0, 0.6) * (rng.random() < 0.5)
        found.append(block((-1.5, 1.5), (-1.5, 1.5), (top - 0.02, top)))
    if rng.random() < scenes.wall:
        side = bearing + np.pi + np.radians(rng.uniform(-50.0, 50.0))
        away, turn = rng.uniform(0.3, 0.9), make_pose(turned(side), (0.0, 0.0, 0.0))
        found.append(block((away, away + 0.1), (-1.2, 1.2), (-0.8, 1.4), pose=turn))
    found = [one for one in found if _spares_base(Obstacles.of((one,)))]
    # No draw where it is not asked for: scenes of a seed stay what they were.
    if scenes.mounted and rng.random() < scenes.mounted:
        found += _mounting(rng)
    return found


def _mounting(rng: np.random.Generator) -> list[Box | Cylinder]:
    """What the arm stands on, level with its base, and what stands there beside it."""
    behind, ahead = rng.uniform(0.1, 0.8), rng.uniform(0.15, 1.2)
    across = (-rng.uniform(0.15, 1.0), rng.uniform(0.15, 1.0))
    thick = rng.uniform(0.02, 0.06) if rng.random() < 0.5 else rng.uniform(0.3, 0.9)
    count = int(rng.integers(0, 6))
    things = standing(rng, count, (-behind, ahead), across, 0.0, 0.3)
    clear = [one for one in things if _spares_base(Obstacles.of((one,)))]
    return [block((-behind, ahead), across, (-thick, 0.0)), *clear]


def _is_reached(
    scenes: SpatialScenes, rng: np.random.Generator, region: GoalRegion, obstacles: Obstacles
) -> bool:
    places = region.draw(rng, _PLACES)
    near = np.linalg.norm(places - (0.0, 0.0, scenes.shoulder_m), axis=1) <= scenes.reach_m
    free = distance_m(obstacles, places) >= scenes.room_m
    off_base = np.hypot(places[:, 0], places[:, 1]) >= 2.0 * _COLUMN_RADIUS_M
    return bool((near & free & off_base).any())


def base_clearance_m(obstacles: Obstacles) -> float:
    """Signed distance between the obstacles and the column in which the arm's base and shoulder stand, m."""
    return float(clearance_m(obstacles, _COLUMN_M, np.full(_COLUMN_M.shape[1], _COLUMN_RADIUS_M))[0])


def _spares_base(obstacles: Obstacles) -> bool:
    return base_clearance_m(obstacles) > 0.0


def draw_cameras(views: CameraViews, rng: np.random.Generator, layout: Layout) -> tuple[DepthCamera, ...]:
    """Cameras that look at a scene."""
    count = int(rng.integers(*views.count, endpoint=True))
    return tuple(_camera(views, rng, layout) for _ in range(count))


def _camera(views: CameraViews, rng: np.random.Generator, layout: Layout) -> DepthCamera:
    for _ in range(_MAX_DRAWS):
        side = np.radians(rng.uniform(*views.side_deg)) * rng.choice((-1.0, 1.0))
        up, away = np.radians(rng.uniform(*views.up_deg)), rng.uniform(*views.distance_m)
        place = camera_place(layout.focus, float(side), float(up), float(away))
        aim = np.array(layout.focus) + rng.normal(size=3) * views.aim_m
        roll, field_deg = (
            np.radians(rng.uniform(-views.roll_deg, views.roll_deg)),
            rng.uniform(*views.field_deg),
        )
        off_base = np.hypot(place[0], place[1]) >= 0.3
        if off_base and distance_m(layout.obstacles, place) >= views.clear_m:
            pose = looking(place, aim, float(roll))
            return DepthCamera.of_field(views.width, views.height, float(field_deg), pose)
    raise ScenarioError("no camera has room in the scene", got=str(views)[:300])


# Poses that are tried for an arm that waits, the first about the ready one, the others anywhere.
_WAITING, _ANYWHERE, _SIGMA_RAD = 32, 256, 0.25


@dataclass(frozen=True, slots=True)
class SpatialScene:
    """An arm among obstacles, seen by depth cameras."""

    world: SpatialWorld
    obstacles: Obstacles
    cameras: tuple[DepthCamera, ...]
    state: tuple[float, ...] | None = None  # (d,) rad; None where the arm is in no picture
    noise: str | None = None  # one of :data:`cspace.worlds.spatial.sensor.NOISES`, or None for exact pictures
    noise_seed: int = 0
    regions: tuple[GoalRegion, ...] = ()
    holes: float = 0.0

    def view(self) -> DepthView:
        rng = np.random.default_rng(self.noise_seed)
        spheres = None if self.state is None else self.world.body.spheres_at(self.state)
        pictures = []
        for camera in self.cameras:
            depth = render_depth(self.obstacles, camera, spheres)
            read = depth if self.noise is None else NOISE_MODELS[self.noise](rng, depth, camera)
            if self.holes and rng.random() < self.holes:
                with_holes = holed(rng, read)
                # A picture that reads nothing at all is none.
                read = with_holes if (with_holes > 0.0).any() else read
            pictures.append(to_mm(read))
        return DepthView(tuple(pictures), self.cameras, self.state)


def draw_scene(rng: np.random.Generator, world: SpatialWorld, split: Split, index: int) -> SpatialScene:
    """A scene of the world's families, with an arm that waits in it."""
    layout = draw_layout(scenes_of(world), split, int(rng.integers(2**62)), index)
    return seen(rng, world, layout, waiting(rng, world.body, layout.obstacles))


def scenes_of(world: SpatialWorld) -> SpatialScenes:
    """The families that a world's scenes come from."""
    if world.scenes is None:
        raise ScenarioError(
            "nobody knows where this world's scenes come from", remedy="name a data set that holds scenes"
        )
    return world.scenes


def seen(
    rng: np.random.Generator, world: SpatialWorld, layout: Layout, state: NDArray[np.float64] | None
) -> SpatialScene:
    """A layout as cameras of the world see it while the arm is at a state (d,) rad."""
    cameras, noises = draw_cameras(world.sensor.views, rng, layout), world.sensor.noise
    noise = noises[int(rng.integers(len(noises)))] if noises else None
    where = None if state is None else tuple(float(angle) for angle in state)
    seed = int(rng.integers(2**62))
    holes = world.sensor.holes
    return SpatialScene(world, layout.obstacles, cameras, where, noise, seed, layout.regions, holes)


def waiting(rng: np.random.Generator, arm: SerialArm, obstacles: Obstacles) -> NDArray[np.float64] | None:
    """Where an arm waits, (d,) rad: free, about the ready pose if it can; None where nothing was found."""
    space, checker = arm.space, CollisionChecker(arm, obstacles)
    ready = ready_rad(arm) + rng.normal(size=(_WAITING, arm.dim)) * _SIGMA_RAD
    tried = np.concatenate([space.wrap(ready), space.sample_uniform(rng, _ANYWHERE)])
    free = tried[checker.valid_batch(tried)]
    return free[0] if len(free) else None
