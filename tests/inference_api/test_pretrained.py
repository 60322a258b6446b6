"""The bundles that ship: whole, small, told where they come from, and better than uniform."""

import re

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.files import SPEC_FILE
from cspace.simulator import Split, scenario_rng
from cspace.worlds import checker_of, examples, simulator_of
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.simulator import render
from inference_api.settings import PRETRAINED_FOLDER, further_folders
from tests.scenarios import random_scenarios

FOLDERS = (PRETRAINED_FOLDER, *further_folders().values())
MAX_BYTES = 40_000_000
SCENARIOS = 20
SAMPLES = 500


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    """The shipped bundle, its sums and its golden case verified."""
    return Bundle.load(PRETRAINED_FOLDER)


@pytest.fixture(scope="module")
def panda() -> Bundle:
    """The shipped bundle of the arm in space, verified likewise."""
    return Bundle.load(further_folders()["pretrained-panda"])


def test_it_tells_how_it_was_made(bundle: Bundle) -> None:
    provenance = bundle.spec.provenance
    assert provenance.command == "python training/cluster_train.py --preset reference"
    assert re.fullmatch(r"[0-9a-f]{40}", provenance.git_commit)
    assert provenance.git_dirty is False
    assert provenance.seeds == {"data": 0, "train": 0}


def test_its_validity_head_lets_free_samples_pass(bundle: Bundle) -> None:
    threshold = bundle.spec.confidence_threshold
    assert threshold is not None
    free, count = [], SCENARIOS * SAMPLES
    for index, scenario in enumerate(random_scenarios(Split.DEMO, 12, SCENARIOS)):
        found = bundle.sample(render(scenario), SAMPLES, index)
        free.append(CollisionChecker(scenario).valid_batch(found.samples))
    assert np.concatenate(free).mean() > 0.99
    assert sum(map(len, free)) == count


def test_its_samples_are_free_more_often_than_uniform_ones(bundle: Bundle) -> None:
    learned, uniform = [], []
    for index, scenario in enumerate(random_scenarios(Split.DEMO, 11, SCENARIOS)):
        checker = CollisionChecker(scenario)
        drawn = np.random.default_rng(index).uniform(-np.pi, np.pi, (SAMPLES, 2))
        samples = bundle.sample(render(scenario), SAMPLES, index, min_confidence=0.0).samples
        learned.append(checker.valid_batch(samples).mean())
        uniform.append(checker.valid_batch(drawn).mean())
    assert np.mean(learned) > np.mean(uniform) + 0.1


def test_all_that_ships_is_small_as_it_is_written_today_and_names_no_folder_of_whoever_made_it(
    bundle: Bundle, panda: Bundle
) -> None:
    files = [file for folder in FOLDERS for file in folder.iterdir()]
    assert sum(file.stat().st_size for file in files) < MAX_BYTES
    # A name of some letters: a million bytes of weights hold ".py" by chance.
    folder = re.compile(rb"[\w/-]{3,}\.py\b(?<!cluster_train\.py)|/home/|/tmp/|/root/")
    assert [file for file in files if folder.search(file.read_bytes())] == []
    written = {one.spec.to_json() for one in (bundle, panda)}
    assert written == {file.read_bytes() for file in files if file.name == SPEC_FILE}


def test_that_of_the_arm_in_space_tells_how_it_was_made_and_what_it_promises(panda: Bundle) -> None:
    today = examples()["panda"]
    assert (panda.spec.world.body, panda.spec.world.sensor.grid) == (today.body, today.sensor.grid)
    provenance = panda.spec.provenance
    assert provenance.command == "python training/cluster_train.py --preset panda"
    assert re.fullmatch(r"[0-9a-f]{40}", provenance.git_commit)
    assert provenance.git_dirty is False
    metrics = provenance.metrics
    assert metrics["promise/samples_collide/scenes"] == 100.0
    assert metrics["promise/samples_collide/measured"] <= metrics["promise/samples_collide/at_most"] <= 0.06


def test_its_samples_are_free_in_space_more_often_than_uniform_ones(panda: Bundle) -> None:
    simulator, space = simulator_of(panda.spec.world), panda.spec.world.space
    served, uniform = [], []
    for index in range(6):
        scene = simulator.scene(scenario_rng(Split.DEMO, 21, index), Split.DEMO, index)
        checker = checker_of(scene)
        found = panda.sample(simulator_of(scene.world).render(scene), 200, index)
        served.append(checker.valid_batch(found.samples).mean())
        uniform.append(checker.valid_batch(space.sample_uniform(np.random.default_rng(index), 1000)).mean())
    assert np.mean(served) > 0.9
    assert np.mean(served) > np.mean(uniform) + 0.2
