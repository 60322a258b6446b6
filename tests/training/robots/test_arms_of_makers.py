"""Arms as their makers publish them, against Pinocchio and against their meshes."""

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import SerialArm
from training.robots.chain import read_chain
from training.robots.description import read_description
from training.robots.importing import import_robot

LIFT = {"torso_lift_joint": 0.0}
# Each arm's file, its tip, the joints that are held, and how many move.
ARMS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", {"panda_finger_joint1": 0.04}, 7),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", "tool0", {}, 6),
    "ur3_gripper": ("ur_description/urdf/ur3_gripper.urdf", "tool0", {}, 6),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0", {}, 6),
    "ur5_gripper": ("ur_description/urdf/ur5_gripper.urdf", "tool0", {}, 6),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", "tool0", {}, 6),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link7", {}, 7),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", {}, 6),
    "talos": ("talos_data/robots/talos_reduced.urdf", "arm_left_7_link", {}, 9),
    "talos_arm": ("talos_data/robots/talos_left_arm.urdf", "arm_left_7_link", {}, 6),
    "baxter_left": ("baxter_description/urdf/baxter.urdf", "left_gripper", {}, 7),
    "baxter_right": ("baxter_description/urdf/baxter.urdf", "right_gripper", {}, 7),
    "so100": ("so_arm_description/urdf/so100.urdf", "jaw", {}, 6),
    "so101": ("so_arm_description/urdf/so101.urdf", "gripper_frame_link", {}, 5),
    "z1": ("z1_description/urdf/z1.urdf", "gripperMover", {}, 7),
    "tiago": ("tiago_description/robots/tiago.urdf", "arm_7_link", {"torso_lift_joint": 0.1}, 7),
    "tiago_dual": ("tiago_description/robots/tiago_dual.urdf", "arm_left_7_link", LIFT, 7),
    "tiago_pro": ("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_7_link", LIFT, 7),
    "pr2": ("pr2_description/urdf/pr2.urdf", "r_wrist_roll_link", {"torso_lift_joint": 0.1}, 7),
    "romeo": ("romeo_description/urdf/romeo.urdf", "l_wrist", {}, 8),
}


def published(name: str) -> Path:
    try:
        found = [
            Path(str(one.locate())) for one in files("example-robot-data") or [] if str(one).endswith(name)
        ]
    except PackageNotFoundError:
        pytest.skip("needs the extra spatial")
    return found[0]


def placed(pin: Any, model: Any, values: dict[str, float]) -> Any:
    """Pinocchio's configuration with joints at angles or lengths."""
    full = pin.neutral(model)
    for name, value in values.items():
        if model.existJointName(name):
            joint = model.joints[model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
            )
    return full


@pytest.mark.parametrize(
    "name", [name if name == "xarm7" else pytest.param(name, marks=pytest.mark.slow) for name in ARMS]
)
def test_kinematics_are_pinocchios(name: str) -> None:
    pin = pytest.importorskip("pinocchio", reason="needs the extra spatial")
    file, tip, locked, joints = ARMS[name]
    path = published(file)
    description = read_description(path, {}, {})
    chain = read_chain(description, tip, locked, {})
    arm = SerialArm(description.name, chain.joints, (), (), chain.tool)
    assert arm.dim == joints
    model = pin.buildModelFromUrdf(str(path))
    links = set(description.links) - {one.parent for one in description.joints.values()}
    data, frame = model.createData(), model.getFrameId(tip or links.pop())
    drawn = np.random.default_rng(0).uniform(arm.space.lower, arm.space.upper, (1000, arm.dim))
    held = {one.name: one.value for one in chain.held}
    worst = 0.0
    for row, mine in zip(drawn, arm.tool_frames(drawn), strict=True):
        moving = dict(zip([joint.name for joint in arm.joints], row, strict=True))
        pin.framesForwardKinematics(model, data, placed(pin, model, held | moving))
        worst = max(worst, float(np.abs(data.oMf[frame].homogeneous - mine).max()))
    assert worst < 1e-6


def test_an_arm_on_a_lift_is_refused_with_what_holds_the_lift() -> None:
    path = published("tiago_description/robots/tiago.urdf")
    with pytest.raises(
        ScenarioError, match=r"torso_lift_joint .*got prismatic.*--lock torso_lift_joint=VALUE"
    ):
        import_robot(path, tip="arm_7_link")


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["panda", "so101", "ur10", "kinova", "baxter_left"])
def test_spheres_cover_the_meshes(name: str) -> None:
    file, tip, locked, joints = ARMS[name]
    found = import_robot(published(file), tip=tip, locked=locked)
    assert found.arm.dim == joints
    large = " ".join(note for note in found.notes if "is large" in note)
    for part, fit in found.fits.items():
        assert fit.missed_m < 0.0025
        assert fit.excess_m < (0.05 if f"link {part} " in large else 0.0105)
