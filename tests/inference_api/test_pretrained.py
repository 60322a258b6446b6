"""The bundle that ships with the project: whole, small, told where it comes from, and better than uniform."""

import re

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.splits import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.planning.collision import CollisionChecker
from cspace.worlds.planar.render import render
from cspace.worlds.planar.scene import random_scenarios
from inference_api.settings import PRETRAINED_FOLDER

MAX_BYTES = 40_000_000
SCENARIOS = 20
SAMPLES = 500


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    """The shipped bundle, its sums and its golden case verified."""
    return Bundle.load(PRETRAINED_FOLDER)


def test_it_holds_a_bundle_and_nothing_else(bundle: Bundle) -> None:
    assert bundle.spec.world.body == TWO_LINK
    files = sorted(PRETRAINED_FOLDER.iterdir())
    assert [file.name for file in files] == [
        "SHA256SUMS",
        "bundle.json",
        "encoder.onnx",
        "generator.onnx",
        "golden.npz",
        "novelty.onnx",
        "validity.onnx",
    ]
    assert sum(file.stat().st_size for file in files) < MAX_BYTES


def test_it_tells_how_it_was_made(bundle: Bundle) -> None:
    provenance = bundle.spec.provenance
    assert provenance.command == "python training/cluster_train.py --preset reference"
    assert re.fullmatch(r"[0-9a-f]{40}", provenance.git_commit)
    assert provenance.git_dirty is False
    assert provenance.seeds == {"data": 0, "train": 0}


def test_its_validity_head_lets_free_samples_pass(bundle: Bundle) -> None:
    threshold = bundle.spec.confidence_threshold
    assert threshold is not None
    free, asked = [], SCENARIOS * SAMPLES
    for index, scenario in enumerate(random_scenarios(Split.DEMO, 12, SCENARIOS)):
        found = bundle.sample(render(scenario), SAMPLES, index)
        free.append(CollisionChecker(scenario).valid_batch(found.samples))
    assert np.concatenate(free).mean() > 0.99
    assert sum(map(len, free)) == asked


def test_its_samples_are_free_more_often_than_uniform_ones(bundle: Bundle) -> None:
    learned, uniform = [], []
    for index, scenario in enumerate(random_scenarios(Split.DEMO, 11, SCENARIOS)):
        checker = CollisionChecker(scenario)
        drawn = np.random.default_rng(index).uniform(-np.pi, np.pi, (SAMPLES, 2))
        samples = bundle.sample(render(scenario), SAMPLES, index, min_confidence=0.0).samples
        learned.append(checker.valid_batch(samples).mean())
        uniform.append(checker.valid_batch(drawn).mean())
    assert np.mean(learned) > np.mean(uniform) + 0.1


def test_it_names_no_folder_of_the_machine_that_made_it() -> None:
    # A name of some letters: a million bytes of weights hold ".py" by chance.
    folder = re.compile(rb"[\w/-]{3,}\.py\b(?<!cluster_train\.py)|/home/|/tmp/|/root/")
    assert [file.name for file in PRETRAINED_FOLDER.iterdir() if folder.search(file.read_bytes())] == []
