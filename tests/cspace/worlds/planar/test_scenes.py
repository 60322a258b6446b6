"""Families of scenes and given ones."""

import json

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.simulator import Split, scenario_rng
from cspace.worlds import read_world, simulator_of
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.world import DiscScenes, GivenScenes, PlanarWorld

SCENES = tuple(((float(number), 2.0, 0.4), (-2.0, 2.0, 0.4)) for number in range(1, 12))


def drawn(scenes: DiscScenes, index: int) -> np.ndarray:
    return scenes.draw(scenario_rng(Split.TRAIN, 1, index), Split.TRAIN, None)


def test_the_family_of_training_is_what_it_was():
    # As drawn before there were families.
    discs = drawn(DiscScenes(), 0)
    rng, expected = scenario_rng(Split.TRAIN, 1, 0), []
    while len(expected) < 3:
        x_m, y_m = rng.uniform(-4.0, 4.0, size=2)
        if np.hypot(x_m, y_m) >= 1.3:
            expected.append((x_m, y_m, 1.0))
    np.testing.assert_array_equal(discs, expected)


def test_every_fifth_given_scene_is_held_out_and_no_other_split_has_it():
    given = GivenScenes.of(SCENES)
    assert given.held_out == (SCENES[4], SCENES[9])
    assert (given.part(Split.VALIDATION), given.part(Split.TEST)) == ((SCENES[4],), (SCENES[9],))
    assert not set(given.part(Split.TRAIN)) & set(given.held_out)
    few = GivenScenes.of(SCENES[:2])
    assert (few.train, few.held_out) == (SCENES[:1], SCENES[1:2])


def test_a_world_tells_its_scenes_and_is_read_again():
    for scenes in (DiscScenes((5, 5), (0.4, 0.4)), GivenScenes.of(SCENES), None):
        world = PlanarWorld(THREE_LINK, scenes=scenes)
        assert read_world(json.loads(json.dumps(world.to_dict()))) == world
    assert "scenes" not in PlanarWorld().to_dict()
    for scenes in ({"count": 3}, {"train": 1}, []):
        with pytest.raises(ScenarioError, match="the scenes"):
            read_world(PlanarWorld().to_dict() | {"scenes": scenes})


def test_a_simulator_makes_given_scenes_one_by_one():
    simulator = simulator_of(PlanarWorld(TWO_LINK, scenes=GivenScenes.of(SCENES)))
    made = [simulator.scene(np.random.default_rng(0), Split.TRAIN, index) for index in range(9)]
    assert len({scene.discs for scene in made}) == 9
    assert simulator.count(Split.TEST) == 1
    assert len(simulator.scenes(Split.TEST, 0, 50)) == 1
    problem = simulator.problem("uniform", Split.TEST, 0)
    assert problem.scenario.disc_array.tolist() == [list(disc) for disc in SCENES[9]]
