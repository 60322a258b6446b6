from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.bundle.load import novelty, quantiles_of
from cspace.errors import BundleIntegrityError
from tests.bundles import PIXELS, tiny_graphs, tiny_spec

QUANTILES = ((-1.0, 0.0, 1.0), (0.0, 1.0, 10.0))


def test_known_pictures_are_seldom_new() -> None:
    rng = np.random.default_rng(0)
    known, fresh = rng.exponential(size=(2, 4000, 2))
    quantiles = quantiles_of(known)
    assert [len(row) for row in quantiles] == [101, 101]
    found = np.array([novelty(row, quantiles) for row in fresh[:1500].astype(np.float32)])
    for level in (0.5, 0.9, 0.98):
        assert np.mean(found > level) <= 1.0 - level + 0.02


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    spec = replace(tiny_spec(), novelty_quantiles=QUANTILES)
    return Bundle.load(write_bundle(tmp_path_factory.mktemp("new") / "bundle", spec, tiny_graphs(spec)))


def test_a_prepared_picture_knows_how_new_it_is(bundle: Bundle) -> None:
    grey = np.full((PIXELS, PIXELS, 3), 128, np.uint8)
    white = np.full((PIXELS, PIXELS, 3), 255, np.uint8)
    # 128 is 0.004 on the network's scale: rank 0.502 by the first score.
    assert bundle.prepare(grey).novelty == pytest.approx(1.0 - 2.0 * (1.0 - 0.502), abs=1e-3)
    assert bundle.prepare(white).novelty == 1.0


def test_a_bundle_without_the_graph_does_not_tell(tiny_bundle: Path) -> None:
    assert Bundle.load(tiny_bundle).prepare(np.zeros((PIXELS, PIXELS, 3), np.uint8)).novelty is None


def test_graph_and_quantiles_come_together_and_fit(tmp_path: Path) -> None:
    spec = replace(tiny_spec(), novelty_quantiles=QUANTILES)
    graphs = tiny_graphs(spec)
    with pytest.raises(BundleIntegrityError, match=r"novelty\.onnx without"):
        write_bundle(tmp_path / "graph", tiny_spec(), graphs)
    with pytest.raises(BundleIntegrityError, match=r"novelty\.onnx without"):
        write_bundle(tmp_path / "quantiles", spec, tiny_graphs(tiny_spec()))
    three = replace(spec, novelty_quantiles=(*QUANTILES, (0.0, 1.0)))
    with pytest.raises(Exception, match="scores"):
        write_bundle(tmp_path / "three", three, graphs)
