import json
from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest

from cspace.worlds.spatial.arm import SerialArm
from tests.training.robots.descriptions import FINGER, TWO_LINKS, described, with_more
from tests.training.worker_peak import worker_peak
from training.robots import spheres
from training.robots.__main__ import main
from training.robots.chain import read_chain
from training.robots.description import read_description
from training.robots.importing import import_robot

CYLINDER, BOX = '<cylinder radius="0.05" length="0.3"/>', '<box size="0.04 0.06 0.1"/>'
# Spheres are taken as they are, which is quick.
ROUND_UPPER = TWO_LINKS.replace(CYLINDER, '<sphere radius="0.15"/>')
ROUND_LOWER = TWO_LINKS.replace(BOX, '<sphere radius="0.05"/>')
ROUND = ROUND_UPPER.replace(BOX, '<sphere radius="0.05"/>')


@pytest.fixture(autouse=True)
def coarse_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spheres, "_GRID_POINTS", 4000)


TOOL_JOINT = '<joint name="to_{0}" type="fixed"><parent link="gripper"/><child link="{0}"/></joint>'


def test_a_description_becomes_a_robot_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "two.json"
    command = ["import", str(described(tmp_path, ROUND_UPPER)), "--ready", "0.5,-1", "--out", str(out)]
    assert main(command) == 0
    arm = SerialArm.from_dict(json.loads(out.read_bytes()))
    assert (arm.name, arm.dim) == ("two", 2)
    assert arm.space.periodic == (False, True)
    assert arm.ready_rad == (0.5, -1.0)
    assert arm.joints[0].limits_rad == (-2.0, 2.0)
    parts = {part.name: part.link for part in arm.parts}
    assert parts == {"base": 0, "upper": 1, "lower": 2, "gripper": 2}
    assert arm.parts[0].spheres_m == ((0.0, 0.0, 0.0, 0.12),)
    assert arm.parts[3].spheres_m == ((0.0, 0.0, 0.32, 0.03),)
    # The elbow turns about the upper arm's y axis, for its frame is turned by a right angle about z.
    tools = arm.tool_frames([[0.0, 0.0], [pi / 2, 0.0], [pi / 2, pi / 2]])[:, :3, 3]
    np.testing.assert_allclose(tools, [[0, 0, 0.9], [0.8, 0, 0.1], [0.5, 0, -0.2]], atol=1e-9)
    output = capsys.readouterr().out
    assert f"two: 2 joints, {arm.sphere_count} spheres" in output
    assert "shoulder: -2 to 2 rad" in output


def test_spheres_cover_what_they_stand_for_and_stick_out_little(tmp_path: Path) -> None:
    arm = import_robot(described(tmp_path, ROUND_LOWER)).arm
    spheres = np.asarray(arm.parts[1].spheres_m)
    rng = np.random.default_rng(0)
    angles, heights = rng.uniform(0, 2 * pi, 5000), rng.uniform(0.1, 0.4, 5000)
    side = np.column_stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), heights])
    outwards = 0.05 * np.sqrt(rng.random(5000))
    top = np.column_stack([outwards * np.cos(angles), outwards * np.sin(angles), np.full(5000, 0.4)])
    for points in (side, top):
        gaps = np.linalg.norm(points[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
        assert gaps.min(axis=1).max() < 0.002
    # A sphere leaves a convex solid by no more than it leaves the planes and the round side.
    beyond = np.maximum(np.linalg.norm(spheres[:, :2], axis=1) - 0.05, np.abs(spheres[:, 2] - 0.25) - 0.15)
    assert (beyond + spheres[:, 3]).max() < 0.0101
    assert len(spheres) < 60
    assert [part.overlap_m for part in arm.parts][1:3] == [
        pytest.approx(0.005, abs=3e-4),
        pytest.approx(0.0, abs=1e-4),
    ]


def test_pairs_that_can_touch_are_those_that_spheres_show(tmp_path: Path) -> None:
    urdf = described(tmp_path, ROUND)
    found = import_robot(urdf)
    srdf = described(
        tmp_path,
        '<robot name="two"><disable_collisions link1="gripper" link2="base" reason="Never"/></robot>',
        "two.srdf",
    )
    # The lower arm is too short for the base; neighbours, which overlap often, are left out.
    assert found.arm.touching == (("base", "gripper"), ("upper", "gripper"))
    shares = {one.pair: one.share for one in found.touching}
    assert shares["base", "lower"] == 0.0
    assert 0.0 < shares["upper", "gripper"] < 0.5
    reasons = {one.pair: one.why for one in found.touching}
    assert reasons["base", "upper"] == "neighbours"
    assert reasons["base", "lower"] == "never overlap"
    # The SRDF beside the description is read without being named.
    without = import_robot(urdf)
    assert without.srdf == srdf
    assert without.arm.touching == (("upper", "gripper"),)
    kept = import_robot(urdf, srdf=srdf, kept=(("base", "gripper"),)).arm.touching
    assert kept == found.arm.touching


def test_held_joints_carry_what_hangs_on_them(tmp_path: Path) -> None:
    description = read_description(described(tmp_path, with_more(FINGER)), {}, {})
    chain = read_chain(description, "finger", {"slide": 0.02, "shoulder": 0.0}, {"elbow": (-1.0, 1.0)})
    assert [joint.name for joint in chain.joints] == ["elbow"]
    assert chain.joints[0].limits_rad == (-1.0, 1.0)
    np.testing.assert_allclose(chain.joints[0].origin.xyz_m, [0.0, 0.0, 0.6])
    np.testing.assert_allclose(chain.tool.xyz_m, [0.0, 0.02, 0.3])
    turned = read_chain(description, "gripper", {"slide": 0.0, "shoulder": pi / 4}, {}).joints[0].origin
    np.testing.assert_allclose(turned.xyz_m, [0.5 / sqrt(2), 0.0, 0.1 + 0.5 / sqrt(2)])


def test_the_same_description_gives_the_same_robot(tmp_path: Path) -> None:
    text = ROUND.replace('<sphere radius="0.03"/>', '<box size="0.02 0.02 0.05"/>')
    urdf = described(tmp_path, text)
    first, second = (import_robot(urdf).arm for _ in range(2))
    assert first == second
    assert first.sphere_count > 4


@pytest.mark.slow
def test_one_mesh_that_is_named_two_hundred_times_ends_within_the_limit_of_memory(tmp_path):
    triangles = np.zeros(200_000, dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    rng = np.random.default_rng(0)
    triangles["c"] = rng.uniform(-0.1, 0.1, (200_000, 1, 3)) + rng.uniform(-0.002, 0.002, (200_000, 3, 3))
    (tmp_path / "m.stl").write_bytes(bytes(80) + np.uint32(200_000).tobytes() + triangles.tobytes())
    shape = '<collision><geometry><mesh filename="m.stl"/></geometry></collision>'
    text = (
        f'<robot name="r"><link name="a"/><link name="b">{shape * 200}</link><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    (tmp_path / "r.urdf").write_text(text)
    done, peak_bytes = worker_peak(
        "training.robots", "import", str(tmp_path / "r.urdf"), "--out", str(tmp_path / "r.json")
    )
    said = done.stderr
    assert done.returncode == 2
    assert "1024 MiB" in said or "want of memory" in said
    assert "simplify the meshes" in said
    # With the libraries of the worker.
    assert peak_bytes < 1.8 * 2**30


def test_without_a_tip_the_last_link_before_a_gripper_is_taken_and_named(tmp_path: Path) -> None:
    chain = read_chain(read_description(described(tmp_path, with_more(FINGER)), {}, {}), None, {}, {})
    assert [joint.name for joint in chain.joints] == ["shoulder", "elbow"]
    assert [
        note for note in chain.notes if note.startswith("the tip is lower, the last link before the gripper")
    ]
    # The wrist's joint turns a gripper's link, and is the arm's.
    text = with_more(FINGER).replace('"lower"', '"jaw_lower"')
    turned = read_chain(read_description(described(tmp_path, text), {}, {}), None, {}, {})
    assert [joint.name for joint in turned.joints] == ["shoulder", "elbow"]
    fork = "".join(f'<link name="{one}"/>{TOOL_JOINT.format(one)}' for one in ("camera", "plate"))
    described(tmp_path, with_more(fork + "</robot>"))
    chain = read_chain(read_description(tmp_path / "two.urdf", {}, {}), None, {}, {})
    assert any(
        note.startswith("the tip is gripper, the last link before the first branch") for note in chain.notes
    )
