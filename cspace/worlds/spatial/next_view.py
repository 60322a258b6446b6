"""Which further depth camera would see most of the space that a way is doubted for. NumPy alone.

Space in which a camera read nothing is mostly the sky: another picture would read nothing either.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError, ScenarioError
from cspace.world import NextView
from cspace.worlds.spatial.seeing.camera import DepthCamera, camera_place, looking, read_camera
from cspace.worlds.spatial.seeing.observed import lookup
from cspace.worlds.spatial.seeing.sight import FREE, NO_READING
from cspace.worlds.spatial.seeing.surface_patches import DISTANCE_STEP_M
from cspace.worlds.spatial.world import SpatialWorld

# The hemisphere about the doubted space: to the sides of the line to the base, and above.
SIDES_DEG = tuple(range(-165, 181, 30))
UPS_DEG = (20.0, 40.0, 60.0)
AWAY_M, FIELD_DEG = 1.2, 70.0
# Nobody puts a camera into the arm, or far below it.
_OFF_BASE_M, _LOWEST_M = 0.35, 0.1
# Voxels of doubted space that are looked at, those with most doubt.
_PLACES = 512
_STEP_M, _NEAR_M = 0.02, 0.0
# A seen surface is met, and so much unseen space hides what is behind it with 1 - 1/e.
_SURFACE_M, _HIDING_M = 0.02, 0.3


def best_view(
    world: SpatialWorld,
    picture: NDArray[np.uint8],
    states: NDArray[np.float64],
    doubts: NDArray[np.float64],
    given: Sequence[object],
) -> NextView | None:
    """See :func:`cspace.worlds.best_view`."""
    places, weights = _doubted(world, picture, states, doubts)
    total = float(doubts.sum())
    if not len(places) or not total > 0.0:
        return None
    cameras = [_camera(one) for one in given] or hemisphere(
        world, np.average(places, axis=0, weights=weights)
    )
    shares = [float(weights @ seen_shares(world, picture, camera, places)) / total for camera in cameras]
    best = int(np.argmax(shares))
    return NextView(cameras[best].to_dict(), shares[best]) if shares[best] > 0.0 else None


def hemisphere(world: SpatialWorld, focus_m: NDArray[np.float64]) -> list[DepthCamera]:
    """Cameras all round and above a point (3,) m that look at it."""
    views, found = world.sensor.views, []
    for up in UPS_DEG:
        for side in SIDES_DEG:
            place = camera_place(focus_m, float(np.radians(side)), float(np.radians(up)), AWAY_M)
            if np.hypot(place[0], place[1]) >= _OFF_BASE_M and place[2] >= _LOWEST_M:
                pose = looking(place, focus_m)
                found.append(DepthCamera.of_field(views.width, views.height, FIELD_DEG, pose))
    return found


def seen_shares(
    world: SpatialWorld, picture: NDArray[np.uint8], camera: DepthCamera, places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How surely a camera would see each place (n, 3) m, (n,): 0 beside its picture and behind surfaces.

    Hidden space may hide what is behind it in turn: the more of it the ray crosses, the surer.
    """
    ahead = camera.shows(camera.project(places))
    to_camera = camera.matrix[:3, 3] - places[ahead]
    length = np.linalg.norm(to_camera, axis=1, keepdims=True)
    steps = np.arange(_NEAR_M, float(length.max(initial=0.0)), _STEP_M)
    points = places[ahead][:, None] + (to_camera / length)[:, None] * steps[:, None]
    grid = world.sensor.grid
    cells = np.floor((points - np.array(grid.low_m)) / grid.voxel_m).astype(np.int64)
    crossed = ((cells >= 0) & (cells < np.array(grid.counts))).all(axis=2) & (steps < length)
    x, y, z = np.moveaxis(np.where(crossed[..., None], cells, 0), -1, 0)
    known = picture[x, y, z]
    surface = crossed & (known[..., 0] * DISTANCE_STEP_M < _SURFACE_M)
    hidden_m = _STEP_M * (crossed & _is_hidden(known[..., 1])).sum(axis=1)
    found = np.zeros(len(places))
    found[ahead] = np.where(surface.any(axis=1), 0.0, np.exp(-hidden_m / _HIDING_M))
    return found


def _doubted(
    world: SpatialWorld,
    picture: NDArray[np.uint8],
    states: NDArray[np.float64],
    doubts: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (n, 3) m of the arm in hidden space along a way, and the doubt that lies on each, (n,).

    A state's doubt lies on its spheres in hidden space, by their volume.
    """
    moving = world.body.sphere_links() > 0
    centres = world.body.sphere_centres_m(states)[:, moving]
    volumes = world.body.spheres_m()[moving, 3] ** 3
    weights = _is_hidden(lookup(picture, world.sensor.grid, centres).codes) * volumes
    sums = weights.sum(axis=1, keepdims=True)
    weights = doubts[:, None] * np.divide(weights, sums, out=np.zeros_like(weights), where=sums > 0.0)
    cells = np.floor((centres - np.array(world.sensor.grid.low_m)) / world.sensor.grid.voxel_m)
    held = weights > 0.0
    _, first, place = np.unique(cells[held], axis=0, return_index=True, return_inverse=True)
    summed = np.bincount(place.ravel(), weights[held], len(first)).astype(np.float64)
    most = np.argsort(-summed, kind="stable")[:_PLACES]
    return centres[held][first[most]], summed[most]


def _is_hidden(codes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((codes != FREE) & (codes != NO_READING))


def _camera(values: object) -> DepthCamera:
    try:
        return read_camera(values)
    except ScenarioError as error:
        raise InputError(
            "a view is no camera",
            expected="objects of fx, fy, cx, cy, width, height and pose",
            got=str(error)[:200],
        ) from error
