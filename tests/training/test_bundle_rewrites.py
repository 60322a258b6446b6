"""Commands that rewrite a bundle: the same networks, other numbers, and clear words for bad input."""

from dataclasses import replace

import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.worlds.planar.arm import PlanarArm
from tests.bundles import tiny_graphs, tiny_spec, write_tiny_bundle
from training import plan_confidence

WIDE = PlanarArm(joint_limits_rad=((-3.0, 3.0), (-3.0, 3.0)))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    spec = replace(tiny_spec(WIDE), confidence_threshold=0.5)
    folder = tmp_path_factory.mktemp("source") / "bundle"
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


@pytest.fixture
def headless(tmp_path):
    return write_tiny_bundle(tmp_path / "headless")


@pytest.mark.slow
def test_plans_are_judged_again(source, tmp_path, capsys):
    command = [str(source), str(tmp_path / "new"), "--problems", "9"]
    assert plan_confidence.main(command) == 0
    for graph in source.glob("*.onnx"):
        assert (tmp_path / "new" / graph.name).read_bytes() == graph.read_bytes()
    before, after = (Bundle.load(folder).spec for folder in (source, tmp_path / "new"))
    assert before.plan_calibration is None
    assert len(after.plan_calibration) == 1
    assert "plans/calibration_error" in capsys.readouterr().out
    assert after.provenance.metrics["plans/fitted"] <= 9
    assert after.confidence_threshold == before.confidence_threshold
    assert plan_confidence.main(command) == 1
    assert "exists" in capsys.readouterr().err


@pytest.mark.slow
def test_what_no_plan_can_be_judged_by_is_refused(source, headless, tmp_path, capsys):
    assert plan_confidence.main([str(source), str(tmp_path / "few"), "--problems", "2"]) == 1
    assert "too few plans" in capsys.readouterr().err
    assert plan_confidence.main([str(headless), str(tmp_path / "none")]) == 1
    assert "no validity head" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
