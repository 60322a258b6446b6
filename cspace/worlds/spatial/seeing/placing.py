"""Cameras that look at a scene, by chance."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.obstacles.layout import Layout
from cspace.worlds.spatial.obstacles.signed_distance import distance_m
from cspace.worlds.spatial.seeing.camera import DepthCamera, looking
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


def camera_place(focus_m: ArrayLike, side_rad: float, up_rad: float, away_m: float) -> NDArray[np.float64]:
    """Where a camera is, (3,) m in the base frame.

    Args:
        focus_m: (3,) what it looks at.
        side_rad: angle on the ground from the line to the base to the line to the camera, left of it above 0.
        up_rad: above the focus's level.
        away_m: from the focus.
    """
    focus = np.asarray(focus_m, dtype=np.float64)
    bearing = np.arctan2(-focus[1], -focus[0]) + side_rad
    level = np.cos(up_rad)
    return np.asarray(
        focus + away_m * np.array([level * np.cos(bearing), level * np.sin(bearing), np.sin(up_rad)])
    )
