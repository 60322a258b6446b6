"""Scenes of the spatial world: what stands about an arm, who looks at it, and where the arm is meanwhile."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.splits import Split
from cspace.strict_json import written
from cspace.worlds.spatial.obstacles.families import draw_layout
from cspace.worlds.spatial.obstacles.layout import GoalRegion, Layout
from cspace.worlds.spatial.obstacles.scenes import SpatialScenes
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.ready import ready_rad
from cspace.worlds.spatial.seeing.camera import DepthCamera
from cspace.worlds.spatial.seeing.depth_picture import to_mm
from cspace.worlds.spatial.seeing.noise import Disparity, Noise, Stereo, StructuredLight, holed
from cspace.worlds.spatial.seeing.placing import draw_cameras
from cspace.worlds.spatial.seeing.render import render_depth
from cspace.worlds.spatial.seeing.view import DepthView
from cspace.worlds.spatial.world import SpatialWorld

_MODELS: dict[str, Noise] = {
    "structured_light": StructuredLight(),
    "disparity": Disparity(),
    "stereo": Stereo(),
}
# Poses that are tried for an arm that waits, the first about the ready one, the others anywhere.
_WAITING, _ANYWHERE, _SIGMA_RAD = 32, 256, 0.25


@dataclass(frozen=True, slots=True)
class SpatialScene:
    """An arm among obstacles, seen by depth cameras.

    Args:
        world: arm and sensor.
        obstacles: in the base frame.
        cameras: one to four.
        state: (d,) rad, where the arm is while it is looked at; None where it is in no picture.
        noise: one of :data:`cspace.worlds.spatial.seeing.sensor.NOISES`, or None for exact pictures.
        noise_seed: of its draws.
        regions: where goals of the hand make sense; none where nobody knows.
        holes: chance of each picture that parts of it read nothing.
    """

    world: SpatialWorld
    obstacles: Obstacles
    cameras: tuple[DepthCamera, ...]
    state: tuple[float, ...] | None = None
    noise: str | None = None
    noise_seed: int = 0
    regions: tuple[GoalRegion, ...] = ()
    holes: float = 0.0

    def view(self) -> DepthView:
        """What the cameras see."""
        rng = np.random.default_rng(self.noise_seed)
        spheres = None if self.state is None else self.world.spheres_at(self.state)
        pictures = []
        for camera in self.cameras:
            depth = render_depth(self.obstacles, camera, spheres).depth_m
            read = depth if self.noise is None else _MODELS[self.noise].apply(rng, depth, camera)
            if self.holes and rng.random() < self.holes:
                with_holes = holed(rng, read)
                # A picture that reads nothing at all is none.
                read = with_holes if (with_holes > 0.0).any() else read
            pictures.append(to_mm(read))
        return DepthView(tuple(pictures), self.cameras, self.state)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "robot": self.world.body.to_dict(),
            "obstacles": self.obstacles.to_dict(),
            "cameras": [camera.to_dict() for camera in self.cameras],
            "state": None if self.state is None else list(self.state),
            "noise": self.noise,
            "noise_seed": self.noise_seed,
            "regions": [written(region) for region in self.regions],
            "holes": self.holes,
        }


def draw_scene(rng: np.random.Generator, world: SpatialWorld, split: Split, index: int) -> SpatialScene:
    """A scene of the world's families, with an arm that waits in it.

    Raises:
        ScenarioError: nobody knows the world's scenes, or none fits their settings.
    """
    layout = draw_layout(scenes_of(world), split, int(rng.integers(2**62)), index)
    return seen(rng, world, layout, waiting(rng, world.body, layout.obstacles))


def scenes_of(world: SpatialWorld) -> SpatialScenes:
    """The families that a world's scenes come from.

    Raises:
        ScenarioError: nobody knows them.
    """
    if world.scenes is None:
        raise ScenarioError(
            "nobody knows where this world's scenes come from",
            expected="families of scenes",
            got="data of one's own, whose obstacles are not known",
            remedy="name a data set that holds scenes",
        )
    return world.scenes


def seen(
    rng: np.random.Generator, world: SpatialWorld, layout: Layout, state: NDArray[np.float64] | None
) -> SpatialScene:
    """A layout as cameras of the world see it while the arm is at a state (d,) rad.

    Raises:
        ScenarioError: no camera has room.
    """
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
