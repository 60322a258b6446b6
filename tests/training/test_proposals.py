"""A bundle whose proposals are mixed again: the same networks, and clear words for bad input."""

from dataclasses import replace

import pytest

from cspace.bundle import Bundle, write_bundle
from tests.bundles import tiny_graphs, tiny_spec, write_tiny_bundle
from training.proposals import main


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    spec = replace(tiny_spec(), confidence_threshold=0.5)
    folder = tmp_path_factory.mktemp("source") / "bundle"
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


@pytest.mark.slow
def test_the_new_bundle_states_what_was_chosen_and_has_the_same_networks(source, tmp_path, capsys):
    assert main([str(source), str(tmp_path / "new")]) == 0
    before, after = Bundle.load(source), Bundle.load(tmp_path / "new")
    spec = after.spec
    assert before.spec.passing_share is None
    assert 0.0 < spec.passing_share <= 1.0
    told = capsys.readouterr().out
    assert f"uniform_share {spec.uniform_share}, threshold {spec.confidence_threshold}" in told
    assert spec.provenance.metrics["proposals/head_us"] > 0.0
    assert spec.provenance.config["proposals_fitted_again"]["source_digest"] == before.digest
    for graph in sorted(source.glob("*.onnx")):
        assert (tmp_path / "new" / graph.name).read_bytes() == graph.read_bytes()
    assert main([str(source), str(tmp_path / "new")]) == 1
    assert "exists" in capsys.readouterr().err


def test_bundles_that_mix_no_proposals_are_refused(tmp_path, capsys):
    headless = write_tiny_bundle(tmp_path / "headless")
    assert main([str(headless), str(tmp_path / "none")]) == 1
    assert "no validity head" in capsys.readouterr().err
    paths = write_tiny_bundle(tmp_path / "paths", kind="path", validity=True)
    assert main([str(paths), str(tmp_path / "none")]) == 1
    assert "free configurations" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
