"""Depth cameras about an arm as a sensor: which ones, and the grid that their pictures are put on."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.strict_json import settle, written
from cspace.view_file import MAX_PICTURES
from cspace.worlds.spatial.seeing.grid_box import GridBox
from cspace.worlds.spatial.seeing.sight import BEHIND_STEP_M, FREE, MOST_BEHIND, OUT_OF_VIEW
from cspace.worlds.spatial.seeing.surface_patches import DISTANCE_STEP_M, FARTHEST
from cspace.worlds.spatial.seeing.views import CameraViews

NOISES = ("structured_light", "disparity", "stereo")


@dataclass(frozen=True, slots=True)
class DepthSensor:
    """What stands for the picture of a scene: an array (X, Y, Z, 2) of what its depth pictures say.

    See :func:`cspace.worlds.spatial.seeing.observed.observe`.

    Args:
        grid: of the array.
        views: the cameras of scenes for training.
        noise: of these, some of :data:`NOISES`, one of them a scene; none for exact pictures.
        arm_hides: whether space behind the arm's pixels counts as hidden, so far behind it; else it is as
            if these pixels had read nothing, which the sky does as well.
        holes: share of the pictures of scenes in which rectangles read nothing, as black and shiny things
            do; a head that knows none takes whatever read nothing for the sky.

    Raises:
        ScenarioError: there are more cameras than a scene may have, or a noise is unknown.
    """

    grid: GridBox
    views: CameraViews = field(default_factory=CameraViews)
    noise: tuple[str, ...] = NOISES
    arm_hides: bool = True
    holes: float = 0.3

    def __post_init__(self) -> None:
        settle(self)
        known = not set(self.noise) - set(NOISES) and 0.0 <= self.holes <= 1.0
        if self.views.count[1] > MAX_PICTURES or not known:
            raise ScenarioError(
                "the depth cameras do not fit",
                expected=f"at most {MAX_PICTURES} of a scene, noise of {', '.join(NOISES)}, a share of holes",
                got=f"{self.views.count[1]} cameras, noise {self.noise}, {self.holes} with holes"[:200],
            )

    @property
    def pixels(self) -> int:
        """Most voxels along a side of the grid."""
        return max(self.grid.counts)

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """(X, Y, Z, 2): distance to what is seen, and what is known."""
        return (*self.grid.counts, 2)

    @property
    def convention(self) -> dict[str, Any]:
        """What a bundle says of its pictures, and of the cameras that it has learned from."""
        views = self.views
        return {
            "grid": self.grid.to_dict(),
            "channels": ["distance to the nearest surface seen", "what is known of the voxel"],
            "distance_step_m": DISTANCE_STEP_M,
            "farther": FARTHEST,
            "behind_step_m": BEHIND_STEP_M,
            **({"arm_hides": True} if self.arm_hides else {}),
            "codes": {"seen free": FREE, "no reading": MOST_BEHIND + 1, "out of view": OUT_OF_VIEW},
            "cameras": {
                "count": list(views.count),
                "pixels": [views.width, views.height],
                "field_deg": list(views.field_deg),
                "distance_m": list(views.distance_m),
            },
            "range": [0, 1],
        }

    @property
    def extent_m(self) -> None:
        """An array of space shows no plane."""
        return

    def to_network(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(..., X, Y, Z, 2) uint8 to (..., 2, X, Y, Z) float32 in [0, 1]."""
        scaled = np.moveaxis(images, -1, -4).astype(np.float32)
        scaled *= np.float32(1.0 / 255.0)
        return np.ascontiguousarray(scaled)

    def from_network(self, pixels: NDArray[np.float32]) -> NDArray[np.uint8]:
        """The inverse of :meth:`to_network`."""
        found = np.rint(np.moveaxis(pixels, -4, -1) * np.float32(255.0)).astype(np.uint8)
        return np.ascontiguousarray(found)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)
