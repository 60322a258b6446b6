"""A bundle's graphs are exported anew from their own weights, and answer as they did."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from cspace.bundle import Bundle, BundleSpec, Provenance, graphs_of, write_bundle
from tests.bundles import picture, write_tiny_bundle
from tests.space_bundle import HEAD, SPEC, space_graphs
from training.models.anew import planar as planar_module
from training.reexport import apart, main

SIZES = {"width": 4, "middle": 4, "deep": 4}
# A planar mixture with a head, both as releases before ADR 0035 exported them.
STACKED = Path(__file__).parents[1] / "cspace" / "bundles" / "stacked_mixture"
CONFIG = {"validity": {"hidden": HEAD.hidden, "grid": SIZES}}


@pytest.fixture(scope="module")
def graphs():
    return space_graphs()


@pytest.fixture(scope="module")
def source(graphs, tmp_path_factory):
    spec = replace(SPEC, provenance=Provenance(config=CONFIG, command="made before"))
    return write_bundle(tmp_path_factory.mktemp("source") / "bundle", spec, graphs)


@pytest.mark.slow
def test_a_head_exported_anew_answers_as_before_and_tells_where_it_comes_from(source, tmp_path, capsys):
    assert main([str(source), str(tmp_path / "new")]) == 0
    origin, made = Bundle.load(source), Bundle.load(tmp_path / "new")
    assert made.digest in capsys.readouterr().out
    told = made.spec.provenance
    assert told.config["exported_anew"] == {"graphs": ["validity"], "source_digest": origin.digest}
    assert told.command == "made before"
    assert apart(origin, made).max() < 1e-5
    for name in ("encoder.onnx", "generator.onnx", "novelty.onnx", "map.onnx", "golden.npz"):
        assert (tmp_path / "new" / name).read_bytes() == (source / name).read_bytes()


@pytest.mark.slow
def test_what_answers_otherwise_is_not_written(source, graphs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("training.reexport.read_back", lambda head, graph: None)
    assert main([str(source), str(tmp_path / "new")]) == 1
    assert "differently" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_graph_without_the_weights_is_told(graphs, tmp_path, capsys):
    graph = onnx.load_from_string(graphs["validity"])
    (bias,) = (item for item in graph.graph.initializer if item.name == "head.whole.0.bias")
    for node in graph.graph.node:
        node.input[:] = ["other" if name == bias.name else name for name in node.input]
    bias.name = "other"
    changed = graphs | {"validity": graph.SerializeToString()}
    spec = replace(SPEC, provenance=Provenance(config=CONFIG))
    other = write_bundle(tmp_path / "other", spec, changed)
    assert main([str(other), str(tmp_path / "new")]) == 1
    assert "the validity graph holds no whole.0.bias" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("config", [{}, {"validity": {"hidden": 8, "grid": None}}])
def test_a_bundle_that_tells_no_sizes_is_refused(graphs, tmp_path, capsys, config):
    other = write_bundle(tmp_path / "other", replace(SPEC, provenance=Provenance(config=config)), graphs)
    assert main([str(other), str(tmp_path / "new")]) == 1
    assert "cannot be exported anew" in capsys.readouterr().err


def test_sizes_that_are_none_are_told(graphs, tmp_path, capsys):
    spec = replace(SPEC, provenance=Provenance(config={"validity": {"hidden": 8, "grid": {"width": 3}}}))
    other = write_bundle(tmp_path / "other", spec, graphs)
    assert main([str(other), str(tmp_path / "new")]) == 1
    assert "the sizes of the bundle's head cannot be read" in capsys.readouterr().err


def test_a_bundle_of_the_plane_is_refused(tmp_path, capsys):
    flat = write_tiny_bundle(tmp_path / "flat", validity=True)
    assert main([str(flat), str(tmp_path / "new")]) == 1
    assert "cannot be exported anew" in capsys.readouterr().err


@pytest.fixture(scope="module")
def planar(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planar") / "new"
    assert main([str(STACKED), str(folder)]) == 0
    return folder


def test_a_planar_mixture_and_its_head_exported_anew_answer_as_before(planar):
    origin, made = Bundle.load(STACKED), Bundle.load(planar)
    note = {"graphs": ["generator", "validity"], "source_digest": origin.digest}
    assert made.spec.provenance.config["exported_anew"] == note
    assert apart(origin, made).max() < 1e-5
    for seed, options in enumerate([{}, {"min_confidence": 0.0}, {"epsilon_sigma": (0.0, 0.5)}]):
        first, second = (bundle.sample(picture(seed), 300, seed, **options) for bundle in (origin, made))
        assert (first.shortfall, first.acceptance) == (second.shortfall, second.acceptance)
        np.testing.assert_allclose(second.samples, first.samples, atol=1e-5)
        np.testing.assert_allclose(second.confidence, first.confidence, atol=1e-5)
    for name in ("encoder.onnx", "golden.npz"):
        assert (planar / name).read_bytes() == (STACKED / name).read_bytes()


def test_what_was_exported_anew_can_be_exported_anew_again(planar, tmp_path):
    assert main([str(planar), str(tmp_path / "again")]) == 0
    assert apart(Bundle.load(planar), Bundle.load(tmp_path / "again")).max() == 0.0


def test_a_cluster_of_no_samples_is_no_error(planar):
    made, alone = Bundle.load(planar), [Bundle.load(planar).sample(picture(0), 1, seed) for seed in range(20)]
    assert all(one.samples.shape == (1, made.spec.dim) for one in alone)


def test_a_sampler_that_answers_otherwise_is_not_written(tmp_path, capsys, monkeypatch):
    read = planar_module._networks

    def exchanged(held):
        return read(held)[::-1]

    monkeypatch.setattr(planar_module, "_networks", exchanged)
    assert main([str(STACKED), str(tmp_path / "new")]) == 1
    assert "differently" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_mixture_that_tells_no_sizes_is_refused(tmp_path, capsys):
    spec = BundleSpec.from_json((STACKED / "bundle.json").read_bytes())
    other = write_bundle(
        tmp_path / "other", replace(spec, provenance=Provenance(config={})), graphs_of(STACKED)
    )
    assert main([str(other), str(tmp_path / "new")]) == 1
    assert "cannot be exported anew" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_a_folder_that_is_there_stays(source, tmp_path, capsys):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "kept").write_text("kept")
    assert main([str(source), str(tmp_path / "new")]) == 1
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["kept"]
    assert "the bundle cannot be written" in capsys.readouterr().err
