"""A bundle of an arm in space: the head reads the scene's map, and tells how much of the arm is unseen."""

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.bundle.files import scene
from cspace.errors import BundleIntegrityError
from tests.space_bundle import SPEC, WORLD, space_graphs


@pytest.fixture(scope="module")
def graphs():
    return space_graphs()


@pytest.fixture(scope="module")
def bundle(graphs, tmp_path_factory):
    return Bundle.load(write_bundle(tmp_path_factory.mktemp("space") / "bundle", SPEC, graphs))


@pytest.fixture(scope="module")
def picture():
    return scene(WORLD.sensor.picture_shape)


def test_samples_come_with_confidence_and_the_unseen_share(bundle, picture):
    prepared = bundle.prepare(picture)
    found = bundle.sample(prepared, 40, 7, min_confidence=0.0)
    assert found.samples.shape == (40, 7)
    assert WORLD.space.contains(found.samples).all()
    confidence, unseen = bundle.predict(prepared, found.samples)
    np.testing.assert_array_equal(found.confidence, confidence)
    np.testing.assert_array_equal(found.unseen, unseen)
    assert 0.0 < unseen.mean() < 1.0
    assert 0.0 <= prepared.novelty <= 1.0


def test_what_is_kept_reaches_the_confidence_and_keeps_its_unseen_share(bundle, picture):
    prepared = bundle.prepare(picture)
    every = bundle.sample(prepared, 200, 1, min_confidence=0.0).confidence
    least = float(np.quantile(every, 0.6))
    found = bundle.sample(prepared, 50, 1, min_confidence=least)
    assert len(found.samples) == 50
    assert (found.confidence >= np.float32(least)).all()
    np.testing.assert_allclose(found.unseen, bundle.predict(prepared, found.samples)[1], atol=1e-6)


def test_an_arm_in_space_that_nothing_shows_is_unseen(bundle, picture):
    hidden = picture.copy()
    hidden[..., 1] = 255
    rows = WORLD.space.to_float32(WORLD.space.sample_uniform(np.random.default_rng(0), 9))
    assert bundle.predict(hidden, rows)[1] == pytest.approx(np.ones(9), abs=1e-5)
    hidden[..., 1] = 0
    assert bundle.predict(hidden, rows)[1] == pytest.approx(np.zeros(9), abs=1e-5)


def test_a_head_that_reads_the_map_comes_with_it(graphs, tmp_path):
    without = {name: graph for name, graph in graphs.items() if name != "map"}
    with pytest.raises(BundleIntegrityError, match=r"validity\.onnx has other inputs or outputs"):
        write_bundle(tmp_path / "bundle", SPEC, without)
    assert list(tmp_path.iterdir()) == []
