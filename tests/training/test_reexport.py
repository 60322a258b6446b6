"""A bundle's head is exported anew from its own weights, and answers as it did."""

from dataclasses import replace

import onnx
import pytest

from cspace.bundle import Bundle, Provenance, write_bundle
from tests.bundles import write_tiny_bundle
from tests.space_bundle import HEAD, SPEC, space_graphs
from training.reexport import apart, main

SIZES = {"width": 4, "middle": 4, "deep": 4}
CONFIG = {"validity": {"hidden": HEAD.hidden, "grid": SIZES}}


@pytest.fixture(scope="module")
def graphs():
    return space_graphs()


@pytest.fixture(scope="module")
def source(graphs, tmp_path_factory):
    spec = replace(SPEC, provenance=Provenance(config=CONFIG, command="made before"))
    return write_bundle(tmp_path_factory.mktemp("source") / "bundle", spec, graphs)


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


@pytest.mark.slow
def test_a_folder_that_is_there_stays(source, tmp_path, capsys):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "kept").write_text("kept")
    assert main([str(source), str(tmp_path / "new")]) == 1
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["kept"]
    assert "the bundle cannot be written" in capsys.readouterr().err
