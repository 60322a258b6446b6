"""Cameras that look at a scene, by chance."""

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.obstacles.layout import Layout
from cspace.worlds.spatial.obstacles.signed_distance import distance_m
from cspace.worlds.spatial.seeing.camera import DepthCamera, camera_place, looking
from cspace.worlds.spatial.seeing.views import CameraViews

_MAX_DRAWS = 300


def draw_cameras(views: CameraViews, rng: np.random.Generator, layout: Layout) -> tuple[DepthCamera, ...]:
    """Cameras that look at a scene.

    Raises:
        ScenarioError: there is no room for one.
    """
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
        if _has_room(views, place, layout):
            pose = looking(place, aim, float(roll))
            return DepthCamera.of_field(views.width, views.height, float(field_deg), pose)
    raise ScenarioError("no camera has room in the scene", got=str(views)[:300])


def _has_room(views: CameraViews, place: NDArray[np.float64], layout: Layout) -> bool:
    off_base = np.hypot(place[0], place[1]) >= 0.3
    return bool(off_base and distance_m(layout.obstacles, place) >= views.clear_m)
