"""A bundle without a generator: its samples lie along ways that are searched for, in their order."""

import shutil
import sys

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.bundle.files import SPEC_FILE, SUMS_FILE, sums_of
from cspace.errors import BundleIntegrityError, GoldenMismatchError
from cspace.planning.paths import STEP_RAD
from cspace.simulator import Split
from cspace.worlds import examples, seen_checkers, simulator_of
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle

WORLD = examples()["two-link"]
SIMULATOR = simulator_of(WORLD)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("ways") / "bundle"
    return write_tiny_bundle(place, kind="path", model_kind="ways", validity=True)


@pytest.fixture(scope="module")
def bundle(folder):
    return Bundle.load(folder)


@pytest.fixture(scope="module")
def problem():
    return SIMULATOR.problem("narrow", Split.VALIDATION, 0, 1)


def ends(problem):
    return {"start": tuple(problem.start), "goal": tuple(problem.goal)}


def test_samples_lie_along_free_ways_in_their_order(bundle, problem):
    image = SIMULATOR.render(problem.scenario)
    found = bundle.sample(image, 600, 7, min_confidence=0.0, **ends(problem))
    assert (len(found.samples), found.shortfall) == (600, 0)
    assert found.confidence.shape == found.ways.shape == (600,)
    first = found.samples[: int(np.argmax(found.ways > 0))]
    assert len(first) > 3
    space = WORLD.space
    assert space.distance(first[:1], problem.start[None])[0] < 1e-5
    assert space.distance(first[-1:], problem.goal[None])[0] < 1e-5
    assert np.all(space.distance(first[:-1], first[1:]) <= STEP_RAD + 1e-5)
    # The head is none that has learned anything: its ways keep to what the picture shows, and no more.
    shown = seen_checkers(WORLD, image, np.array([problem.start, problem.goal]))
    assert shown[-1].valid_batch(first).all()
    turns = np.flatnonzero(np.diff(found.ways) < 0)
    assert np.all(np.diff(found.ways[: turns[0] + 1]) >= 0)


def test_a_confidence_to_reach_drops_samples_and_keeps_the_order_of_ways(bundle, problem):
    image = SIMULATOR.render(problem.scenario)
    plain = bundle.sample(image, 200, 7, min_confidence=0.0, **ends(problem))
    least = float(np.quantile(plain.confidence, 0.3))
    found = bundle.sample(image, 200, 7, min_confidence=least, **ends(problem))
    assert np.all(found.confidence >= np.float32(least))
    assert 0.0 < found.acceptance < 1.0
    assert len(found.ways) == len(found.samples) == 200 - found.shortfall


def test_it_is_loaded_and_scores_where_nothing_compiles(folder, monkeypatch):
    for name in ("numba", "cspace.worlds.planar.collision"):
        monkeypatch.setitem(sys.modules, name, None)
    bundle = Bundle.load(folder)
    rows = np.zeros((3, 2), dtype=np.float32)
    assert bundle.predict(picture(1), rows)[0].shape == (3,)
    with pytest.raises(ImportError):
        bundle.sample(picture(1), 10, 7, start=(0.0, 0.0), goal=(1.0, 1.0))


def test_its_golden_case_holds_the_head(folder, tmp_path):
    copy = tmp_path / "other"
    shutil.copytree(folder, copy)
    contents = {file.name: file.read_bytes() for file in copy.iterdir() if file.name != SUMS_FILE}
    contents["validity.onnx"] = contents["validity.onnx"].replace(b"Abs", b"Neg")
    for name, data in {**contents, SUMS_FILE: sums_of(contents)}.items():
        (copy / name).write_bytes(data)
    with pytest.raises(GoldenMismatchError):
        Bundle.load(copy)


@pytest.mark.parametrize(
    ("kind", "model_kind", "parts"),
    [
        ("configuration", "ways", ("encoder", "validity")),
        ("path", "ways", ("encoder",)),
        ("path", "ways", ("encoder", "generator", "validity")),
        ("path", "generator", ("encoder", "validity")),
    ],
)
def test_parts_that_do_not_fit_are_no_bundle(tmp_path, kind, model_kind, parts):
    graphs = tiny_graphs(tiny_spec(kind="path"), validity=True)
    with pytest.raises(BundleIntegrityError):  # noqa: PT012
        spec = tiny_spec(kind=kind, model_kind=model_kind)
        write_bundle(tmp_path / "bundle", spec, {name: graphs[name] for name in parts})
    assert not (tmp_path / "bundle" / SPEC_FILE).exists()
