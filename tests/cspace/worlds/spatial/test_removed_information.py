"""Depth views of which something is removed: the answer is not surer for knowing less."""

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cspace.errors import InputError
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.spatial.camera import looking
from cspace.worlds.spatial.sensor import grid_of
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.visibility import lookup
from tests.space_bundle import WORLD

# Voxels that are quick, m; of the arm's share in unseen space.
COARSE_M, MARGIN = 0.05, 0.02
COARSE = replace(WORLD, sensor=replace(WORLD.sensor, grid=grid_of(WORLD.body, COARSE_M)))
CENTRES = WORLD.body.sphere_centres_m(WORLD.space.sample_uniform(np.random.default_rng(0), 96))
VOLUMES = WORLD.body.spheres_m()[:, 3] ** 3
Rng = random.Random


def without_pixels(rng: Rng, view: DepthView) -> DepthView:
    pictures = [picture.copy() for picture in view.pictures]
    picture = rng.choice(pictures)
    row, column = (rng.randrange(side) for side in picture.shape)
    picture[row : row + rng.randint(1, 64), column : column + rng.randint(1, 64)] = rng.choice((0, 65535))
    return replace(view, pictures=tuple(pictures))


def turned_away(rng: Rng, view: DepthView) -> DepthView:
    cameras = [*view.cameras]
    number = rng.randrange(len(cameras))
    place = cameras[number].matrix[:3, 3]
    pose = looking(place, place + place * (1.0, 1.0, 0.0), rng.uniform(-3.0, 3.0))
    cameras[number] = replace(cameras[number], pose=tuple(map(tuple, pose.tolist())))
    return replace(view, cameras=tuple(cameras))


def fewer_pixels(rng: Rng, view: DepthView) -> DepthView:
    step = rng.choice((2, 3, 4))
    pictures = tuple(np.ascontiguousarray(one[::step, ::step]) for one in view.pictures)
    cameras = []
    for camera, picture in zip(view.cameras, pictures, strict=True):
        scaled = {name: getattr(camera, name) / step for name in ("fx", "fy", "cx", "cy")}
        cameras.append(replace(camera, **scaled, width=picture.shape[1], height=picture.shape[0]))
    return replace(view, pictures=pictures, cameras=tuple(cameras))


def fewer_pictures(rng: Rng, view: DepthView) -> DepthView:
    kept = sorted(rng.sample(range(len(view.pictures)), max(1, len(view.pictures) - 1)))
    pictures, cameras = (tuple(both[one] for one in kept) for both in (view.pictures, view.cameras))
    return replace(view, pictures=pictures, cameras=cameras)


def unseen_and_warnings(view: DepthView) -> tuple[Any, set[str]]:
    read = COARSE.examined(view)
    unseen = lookup(read.images[0], COARSE.sensor.grid, CENTRES).unseen @ (VOLUMES / VOLUMES.sum())
    return unseen, {one.code for one in read.findings}


@pytest.mark.slow
@pytest.mark.parametrize("remove", [without_pixels, turned_away, fewer_pixels, fewer_pictures])
def test_less_information_does_not_make_more_space_seen_without_a_warning(
    remove: Callable[[Rng, DepthView], DepthView],
) -> None:
    answered = 0
    simulator: Any = simulator_of(WORLD)
    for scene in simulator.scenes(Split.DEMO, 11, 4):
        view = scene.view()
        before, warned = unseen_and_warnings(view)
        for seed in range(8):
            try:
                after, warned_now = unseen_and_warnings(remove(Rng(seed), view))
            except InputError:
                continue
            answered += 1
            assert (before - after).mean() < MARGIN or warned_now - warned
    assert answered > 16
