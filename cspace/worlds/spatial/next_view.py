"""Which further depth camera would see most of the doubtful space about a path. NumPy alone.

A camera beside one that has looked sees past what hid that path alone, so cameras from elsewhere go first.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError, ScenarioError
from cspace.world import NextView
from cspace.worlds.spatial.camera import DepthCamera, camera_place, camera_pose, looking, read_camera
from cspace.worlds.spatial.sensor import DISTANCE_STEP_M, FREE, NO_READING
from cspace.worlds.spatial.view import cameras_in_base, state_of
from cspace.worlds.spatial.world import SpatialWorld

# Cameras about the uncertain space: so many to each side, and so many heights.
_SIDES, _HEIGHTS = 5, 3
# Nobody puts a camera into the arm, or far below it.
_OFF_BASE_M, _LOWEST_M = 0.35, 0.1
# Voxels of doubtful space that are looked at, the most doubtful.
_PLACES = 512
_STEP_M = 0.02
# A seen surface is met, and so much unseen space hides what is behind it with 1 - 1/e.
_SURFACE_M, _HIDING_M = 0.02, 0.3
# About what is uncertain, from a camera that has looked to one from elsewhere, at least.
_ELSEWHERE_DEG = 45.0


def best_view(
    world: SpatialWorld,
    picture: NDArray[np.uint8],
    doubt: NDArray[np.float32],
    given: Sequence[object],
    check_cancelled: Callable[[], None],
    seen_by: Sequence[Mapping[str, Any]] = (),
    seen_state: object = None,
) -> NextView | None:
    """See :func:`cspace.worlds.best_view`."""
    most = np.argsort(-doubt, axis=None, kind="stable")[:_PLACES]
    weights = doubt.reshape(-1)[most].astype(np.float64)
    places, total = world.sensor.grid.centres_m().reshape(-1, 3)[most], float(doubt.sum())
    if not total > 0.0:
        return None
    focus_m = np.average(places, axis=0, weights=weights)
    cameras = [_camera(one) for one in given] or hemisphere(world, focus_m)
    shares = []
    for camera in cameras:
        check_cancelled()
        shares.append(float(weights @ seen_shares(world, picture, camera, places)) / total)
    state = state_of(seen_state, len(seen_by), world.space)
    looked: list[Any] = cameras_in_base(seen_by, state, world.body)
    chosen = _from_elsewhere(cameras, looked, focus_m) & (np.array(shares) > 0.0)
    best = int(np.argmax(np.where(chosen, shares, 0.0) if chosen.any() else shares))
    return NextView(cameras[best].to_dict(), shares[best]) if shares[best] > 0.0 else None


def hemisphere(world: SpatialWorld, focus_m: NDArray[np.float64]) -> list[DepthCamera]:
    """Cameras that look at a point (3,) m from where the cameras of the world's training stood.

    Others see more where the arm is not in the way, but a model knows less of what they see.
    """
    views, found = world.sensor.views, []
    sides = np.radians(np.linspace(*views.side_deg, _SIDES))
    for up in np.radians(np.linspace(*views.up_deg, _HEIGHTS)):
        for side in (*-sides, *sides):
            place = camera_place(focus_m, float(side), float(up), away_m(world))
            if np.hypot(place[0], place[1]) >= _OFF_BASE_M and place[2] >= _LOWEST_M:
                field_deg, pose = float(np.mean(views.field_deg)), looking(place, focus_m)
                found.append(DepthCamera.of_field(views.width, views.height, field_deg, pose))
    return found


def _from_elsewhere(
    cameras: Sequence[DepthCamera], seen_by: Sequence[Mapping[str, Any]], focus_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which cameras (n,) look at a point (3,) m from another side than all that have looked."""
    if not seen_by:
        return np.ones(len(cameras), dtype=np.bool_)
    new = _directions(np.array([one.matrix[:3, 3] for one in cameras]), focus_m)
    old = _directions(np.array([camera_pose(one) for one in seen_by])[:, :3, 3], focus_m)
    return np.asarray((new @ old.T).max(axis=1) <= np.cos(np.radians(_ELSEWHERE_DEG)))


def _directions(places: NDArray[np.float64], focus_m: NDArray[np.float64]) -> NDArray[np.float64]:
    away = places - focus_m
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def away_m(world: SpatialWorld) -> float:
    """How far from what they look at the cameras of :func:`hemisphere` are, m."""
    return float(np.mean(world.sensor.views.distance_m))


def seen_shares(
    world: SpatialWorld, picture: NDArray[np.uint8], camera: DepthCamera, places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How surely a camera would see each place (n, 3) m, (n,): 0 beside its picture and behind surfaces.

    Hidden space may hide what is behind it in turn: the more of it the ray crosses, the more likely.
    """
    ahead = camera.shows(camera.project(places))
    to_camera = camera.matrix[:3, 3] - places[ahead]
    length = np.linalg.norm(to_camera, axis=1, keepdims=True)
    grid = world.sensor.grid
    # However far a camera is: beyond the grid nothing is known of what a ray crosses.
    across_m = float(grid.voxel_m * np.linalg.norm(grid.counts))
    steps = np.arange(0.0, min(float(length.max(initial=0.0)), across_m), _STEP_M)
    points = places[ahead][:, None] + (to_camera / length)[:, None] * steps[:, None]
    cells = np.floor((points - np.array(grid.low_m)) / grid.voxel_m).astype(np.int64)
    crossed = ((cells >= 0) & (cells < np.array(grid.counts))).all(axis=2) & (steps < length)
    x, y, z = np.moveaxis(np.where(crossed[..., None], cells, 0), -1, 0)
    known = picture[x, y, z]
    surface = crossed & (known[..., 0] * DISTANCE_STEP_M < _SURFACE_M)
    hidden_m = _STEP_M * (crossed & (known[..., 1] != FREE) & (known[..., 1] != NO_READING)).sum(axis=1)
    found = np.zeros(len(places))
    found[ahead] = np.where(surface.any(axis=1), 0.0, np.exp(-hidden_m / _HIDING_M))
    return found


def _camera(values: object) -> DepthCamera:
    try:
        return read_camera(values)
    except ScenarioError as error:
        raise InputError(
            "a view is no camera",
            expected="objects of fx, fy, cx, cy, width, height and pose",
            got=str(error)[:200],
        ) from error
