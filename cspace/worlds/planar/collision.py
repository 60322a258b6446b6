"""Collision checks of an arm among discs: numba kernels, and the checker of a scene or of a picture."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit
from cspace.planning.kernels import SceneKernels
from cspace.simulator import Checker
from cspace.worlds.planar.arm import link_offsets_m
from cspace.worlds.planar.world import KnownDiscs, PlanarWorld, Scenario


class SceneArrays(NamedTuple):
    """An arm of d joints among discs as the kernels take it."""

    links: NDArray[np.float64]  # (d,) m
    half_width: float  # m
    discs: NDArray[np.float64]  # (D, 3) x, y, radius, m
    lower: NDArray[np.float64]  # (d,) rad
    upper: NDArray[np.float64]  # (d,) rad
    periodic: NDArray[np.bool_]  # (d,) which joints are circles


@njit(cache=True, nogil=True)
def room_of(_scene):  # type: ignore[no-untyped-def]
    """None: these checks work in no arrays."""


@njit(cache=True, nogil=True)
def state_clearance(q, scene, _room):  # type: ignore[no-untyped-def]
    """Smallest distance of the arm's capsules at a configuration (d,) to the discs, m; inf without any."""
    links, discs, clearance = scene.links, scene.discs, np.inf
    x0, y0, heading = 0.0, 0.0, 0.0
    for joint in range(links.shape[0]):
        heading += q[joint]
        dx, dy = links[joint] * np.cos(heading), links[joint] * np.sin(heading)
        for disc in range(discs.shape[0]):
            px, py = discs[disc, 0] - x0, discs[disc, 1] - y0
            along = (px * dx + py * dy) / (dx * dx + dy * dy)
            along = min(1.0, max(0.0, along))
            gap = np.hypot(px - along * dx, py - along * dy) - discs[disc, 2] - scene.half_width
            clearance = min(clearance, gap)
        x0 += dx
        y0 += dy
    return clearance


@njit(cache=True, nogil=True)
def state_is_free(q, scene, room):  # type: ignore[no-untyped-def]
    """Whether one configuration (d,) is within its limits and clear of every disc."""
    for joint in range(q.shape[0]):
        if not scene.periodic[joint] and not scene.lower[joint] <= q[joint] <= scene.upper[joint]:
            return False
    return state_clearance(q, scene, room) > 0.0


KERNELS = SceneKernels(state_is_free, state_clearance, room_of)

# Of a pixel's side, that obstacles are taken to be larger; the most careful first.
MARGINS = (0.5, 0.0, -0.25)
# Of a pixel, from which on it counts as covered.
_COVERED = 0.25
# Blue of the picture where a pixel is wholly covered, and where it is not covered.
_GROUND = 255.0


class CollisionChecker(Checker):
    """Exact checks of an arm among discs: every clearance is above zero."""

    def __init__(self, scenario: Scenario) -> None:
        space, robot = scenario.robot.space, scenario.robot
        arrays = SceneArrays(
            np.asarray(robot.link_lengths_m, dtype=np.float64),
            float(robot.half_width_m),
            scenario.disc_array,
            np.asarray(space.lower, dtype=np.float64),
            np.asarray(space.upper, dtype=np.float64),
            np.asarray(space.periodic, dtype=np.bool_),
        )
        super().__init__(space, arrays, KERNELS)
        self.scenario = scenario


def seen_checkers(
    world: PlanarWorld,
    picture: NDArray[np.uint8],
    ends: NDArray[np.float64],
    known: KnownDiscs | None = None,
) -> list[CollisionChecker]:
    """See :func:`cspace.worlds.seen_checkers`; covered pixels are discs of their area, known discs exact."""
    camera, arm = world.sensor, world.body
    if known is not None:
        picture = known.seen
    # Red discs lie over the blue arm and the white ground.
    covered = 1.0 - picture[..., 2] / _GROUND
    # An arm that touches a pixel surrounded by others touches these before.
    framed = np.pad(covered >= _COVERED, 1)
    inner = framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    rows, columns = np.nonzero(framed[1:-1, 1:-1] & ~inner)
    left, right, bottom, top = camera.extent_m
    height, width = (top - bottom) / camera.pixels, (right - left) / camera.pixels
    places = np.stack([left + (columns + 0.5) * width, top - (rows + 0.5) * height], axis=1)
    radii = np.sqrt(covered[rows, columns] * width * height / np.pi)
    least = np.zeros(len(radii))
    if known is not None:
        places = np.concatenate([places, known.discs[:, :2]])
        radii, least = (np.concatenate([one, known.discs[:, 2]]) for one in (radii, least))
    offsets = link_offsets_m(arm.joint_positions_m(ends), places)
    room = np.linalg.norm(offsets, axis=-1).min(axis=(0, 1)) - arm.half_width_m
    found = []
    for margin in MARGINS:
        sizes = np.maximum(np.minimum(radii + margin * width, 0.99 * room), least)
        discs = np.column_stack([places, sizes])[sizes > 0.0]
        found.append(CollisionChecker(Scenario.from_array(arm, discs, camera)))
    return found
