"""A bundle with narrower limits: the same networks, no sample outside, and clear words for wider ones."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.benchmark import LIMITS_RAD
from cspace.worlds.spatial.world import shipped
from tests.bundles import picture, tiny_graphs, tiny_spec
from training.limits import main
from training.motionbench.__main__ import main as motionbench

WIDE = PlanarArm(joint_limits_rad=((-3.0, 3.0), (-3.0, 3.0)))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    spec = replace(tiny_spec(WIDE), confidence_threshold=0.1)
    folder = tmp_path_factory.mktemp("source") / "bundle"
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


def limited(source, folder, *limit):
    width = str(WIDE.half_width_m)
    links = map(str, WIDE.link_lengths_m)
    arm = ["--links", *links, "--half-width", width, "--limit", "1", *limit, "--limit", "2", "-3", "3"]
    return main([str(source), str(folder), *arm])


def test_the_new_bundle_keeps_to_the_limits_with_the_same_networks(source, tmp_path):
    assert limited(source, tmp_path / "new", "-1.5", "2.5") == 0
    before, after = Bundle.load(source), Bundle.load(tmp_path / "new")
    assert after.spec.joint_space["lower"] == [-1.5, -3.0]
    samples = after.sample(picture(), 500, 2).samples
    assert len(samples) == 500
    assert after.spec.world.space.contains(samples).all()
    assert before.spec.world.body != after.spec.world.body
    told = after.spec.provenance.config["limits_narrowed"]
    assert told["source_digest"] == before.digest
    assert told["trained_lower"] == [-3.0, -3.0]
    for graph in sorted(source.glob("*.onnx")):
        assert (tmp_path / "new" / graph.name).read_bytes() == graph.read_bytes()


def test_wider_limits_are_refused(source, tmp_path, capsys):
    assert limited(source, tmp_path / "new", "-3.1", "2.5") == 1
    assert "the limits do not fit the bundle" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_the_benchmarks_robot_is_the_shipped_one_with_wider_limits(tmp_path):
    assert motionbench(["robot", "--out", str(tmp_path / "panda.json")]) == 0
    arm = SerialArm.from_dict(json.loads((tmp_path / "panda.json").read_text()))
    assert arm == shipped("panda").with_limits(LIMITS_RAD)
    assert np.less(arm.space.lower, shipped("panda").space.lower).all()
