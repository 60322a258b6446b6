"""A bundle whose plans are judged again: other numbers, the same networks, and clear words for bad input."""

import pytest

from cspace.bundle import Bundle
from tests.bundles import write_tiny_bundle
from training.plan_confidence import main


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return write_tiny_bundle(tmp_path_factory.mktemp("source") / "bundle", validity=True)


@pytest.mark.slow
def test_the_new_bundle_states_what_was_fitted_and_has_the_same_networks(source, tmp_path, capsys):
    assert main([str(source), str(tmp_path / "new"), "--problems", "9"]) == 0
    before, after = Bundle.load(source).spec, Bundle.load(tmp_path / "new").spec
    assert before.plan_doubt is None
    assert f"plan_doubt {after.plan_doubt}" in capsys.readouterr().out
    assert after.provenance.metrics["plans/fitted"] + after.provenance.metrics["plans/measured"] <= 9
    assert after.confidence_threshold == before.confidence_threshold
    for graph in sorted(source.glob("*.onnx")):
        assert (tmp_path / "new" / graph.name).read_bytes() == graph.read_bytes()
    assert main([str(source), str(tmp_path / "new"), "--problems", "9"]) == 1
    assert "exists" in capsys.readouterr().err


def test_what_cannot_be_fitted_is_refused(source, tmp_path, capsys):
    assert main([str(source), str(tmp_path / "few"), "--problems", "5"]) == 2
    assert "6 or more" in capsys.readouterr().err
    headless = write_tiny_bundle(tmp_path / "headless")
    assert main([str(headless), str(tmp_path / "none")]) == 1
    assert "no validity head" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
