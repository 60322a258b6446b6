"""Commands that rewrite a bundle: the same networks, other numbers, and clear words for bad input."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.benchmark import LIMITS_RAD
from cspace.worlds.spatial.world import shipped
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle
from training import limits, plan_confidence
from training.motionbench import main as motionbench

WIDE = PlanarArm(joint_limits_rad=((-3.0, 3.0), (-3.0, 3.0)))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    spec = replace(tiny_spec(WIDE), confidence_threshold=0.5)
    folder = tmp_path_factory.mktemp("source") / "bundle"
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


@pytest.fixture
def headless(tmp_path):
    return write_tiny_bundle(tmp_path / "headless")


def both(source, new):
    """The two bundles, whose networks are the same."""
    for graph in sorted(source.glob("*.onnx")):
        assert (new / graph.name).read_bytes() == graph.read_bytes()
    return Bundle.load(source), Bundle.load(new)


def limited(source, folder, *limit):
    width = str(WIDE.half_width_m)
    links = map(str, WIDE.link_lengths_m)
    arm = ["--links", *links, "--half-width", width, "--limit", "1", *limit, "--limit", "2", "-3", "3"]
    return limits.main([str(source), str(folder), *arm])


def test_narrower_limits_are_kept_to(source, tmp_path):
    assert limited(source, tmp_path / "new", "-1.5", "2.5") == 0
    before, after = both(source, tmp_path / "new")
    assert after.spec.joint_space["lower"] == [-1.5, -3.0]
    samples = after.sample(picture(), 500, 2, min_confidence=0.1).samples
    assert len(samples) == 500
    assert after.spec.world.space.contains(samples).all()
    assert before.spec.world.body != after.spec.world.body
    note = after.spec.provenance.config["limits_narrowed"]
    assert note["source_digest"] == before.digest
    assert note["trained_lower"] == [-3.0, -3.0]


def test_wider_limits_are_refused(source, tmp_path, capsys):
    assert limited(source, tmp_path / "new", "-3.1", "2.5") == 1
    assert "the limits do not fit the bundle" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_the_benchmarks_robot_is_the_shipped_one_with_wider_limits(tmp_path):
    assert motionbench(["robot", "--out", str(tmp_path / "panda.json")]) == 0
    arm = SerialArm.from_dict(json.loads((tmp_path / "panda.json").read_text()))
    assert arm == shipped("panda").with_limits(LIMITS_RAD)
    assert np.less(arm.space.lower, shipped("panda").space.lower).all()


@pytest.mark.slow
def test_plans_are_judged_again(source, tmp_path, capsys):
    command = [str(source), str(tmp_path / "new"), "--problems", "9"]
    assert plan_confidence.main(command) == 0
    before, after = (one.spec for one in both(source, tmp_path / "new"))
    assert before.plan_calibration is None
    assert f"plan_calibration {after.plan_calibration}" in capsys.readouterr().out
    assert after.provenance.metrics["plans/fitted"] <= 9
    assert after.confidence_threshold == before.confidence_threshold
    assert plan_confidence.main(command) == 1
    assert "exists" in capsys.readouterr().err


@pytest.mark.slow
def test_what_no_plan_can_be_judged_by_is_refused(source, headless, tmp_path, capsys):
    assert plan_confidence.main([str(source), str(tmp_path / "few"), "--problems", "5"]) == 2
    assert "6 or more" in capsys.readouterr().err
    assert plan_confidence.main([str(headless), str(tmp_path / "none")]) == 1
    assert "no validity head" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
