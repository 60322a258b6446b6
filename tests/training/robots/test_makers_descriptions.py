"""Descriptions as makers write them: the right robot, or an error with names, line and what to do."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cspace.errors import ScenarioError
from cspace.worlds import robot_digest
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.sensor import MAX_VOXELS, grid_of
from cspace.worlds.spatial.world import usual
from tests.training.robots.descriptions import BRANCH, FINGER, described, with_more
from training.robots.importing import Imported, import_robot

BALL = '<{kind}><geometry><sphere radius="{radius}"/></geometry></{kind}>'
LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'


def chain(
    *limits: str,
    kinds: str = "collision collision collision collision",
    radius: float = 0.06,
    step: float = 0.3,
) -> str:
    """Links l0 to l3 one above the other; joints j1 to j3 about y hold what is given, or limits."""
    rows = ['<robot name="three">']
    shapes = [BALL.format(kind=kind, radius=radius) for kind in kinds.split()]
    rows += [f'<link name="l{index}">{shape}</link>' for index, shape in enumerate(shapes)]
    for index, held in enumerate((*limits, *[LIMIT] * (3 - len(limits))), 1):
        kind = "continuous" if held.startswith("continuous") else "revolute"
        rows.append(
            f'<joint name="j{index}" type="{kind}"><parent link="l{index - 1}"/><child link="l{index}"/>'
            f'<origin xyz="0 0 {step}"/><axis xyz="0 1 0"/>{held.removeprefix("continuous")}</joint>'
        )
    return "\n".join([*rows, "</robot>"])


def imported(folder: Path, text: str, **options: object) -> Imported:
    return import_robot(described(folder, text), **options)


CIRCLE, TURN = [None, (-2.0, 2.0), (-2.0, 2.0)], [(-1.0, 1.0), None, (-2.0, 2.0)]


@pytest.mark.parametrize(
    ("limit", "options", "limits_rad"),
    [
        ('<limit lower="0" upper="0"/>', {}, CIRCLE),
        ('<limit lower="-inf" upper="inf"/>', {}, CIRCLE),
        ("", {}, CIRCLE),
        ("", {"j1": (-1.0, 1.0), "j2": None}, TURN),
    ],
)
def test_a_continuous_joint_is_a_circle_unless_an_option_limits_it(
    tmp_path: Path, limit: str, options: dict[str, object], limits_rad: list[object]
) -> None:
    found = imported(tmp_path, chain(f"continuous{limit}"), limits=options)
    assert [joint.limits_rad for joint in found.arm.joints] == limits_rad


def test_visual_shapes_stand_in_for_collision_shapes_with_a_warning(tmp_path: Path) -> None:
    found = imported(tmp_path, chain(kinds="collision collision visual visual"))
    assert [part.name for part in found.arm.parts] == ["l0", "l1", "l2", "l3"]
    assert any("visual shapes are taken: l2, l3" in note for note in found.notes)


def test_a_shape_of_no_size_is_left_out_with_its_link_and_line(tmp_path: Path) -> None:
    placeholder = '<link name="l3"><collision><geometry><box size="0 0 0"/></geometry></collision></link>'
    text = chain().replace(
        '<link name="l3">' + BALL.format(kind="collision", radius=0.06) + "</link>", placeholder
    )
    found = imported(tmp_path, text)
    assert "a box of link l3 has no size and is left out" in found.notes
    assert [part.name for part in found.arm.parts] == ["l0", "l1", "l2"]
    meshed = text.replace('<box size="0 0 0"/>', '<mesh filename="nowhere.stl" scale="0 0 0"/>')
    assert any("a mesh of link l3 has no size" in note for note in imported(tmp_path, meshed).notes)


def test_soft_limits_and_those_of_moveit_s_file_are_taken_and_told(tmp_path: Path) -> None:
    soft = LIMIT + '<safety_controller soft_lower_limit="-1.5" soft_upper_limit="3" k_velocity="10"/>'
    none = LIMIT + '<safety_controller k_velocity="10"/>'
    rows = "  j3: {has_position_limits: true, min_position: -1, max_position: 1}\n  hand: {max_velocity: 1}\n"
    (tmp_path / "joint_limits.yaml").write_text(f"joint_limits:\n{rows}")
    found = imported(tmp_path, chain(soft, none))
    assert [joint.limits_rad for joint in found.arm.joints] == [(-1.5, 2.0), (-2.0, 2.0), (-1.0, 1.0)]
    assert {
        "limits of joint_limits.yaml are taken: j3",
        "the soft limits of safety_controller are taken: j1",
    } <= {*found.notes}


def test_limits_of_velocity_and_acceleration_are_taken_where_all_joints_have_them(tmp_path: Path) -> None:
    fast = LIMIT.replace('velocity="1"', 'velocity="2.5"')
    found = imported(tmp_path, chain(fast, fast, fast)).arm
    assert (found.max_velocity_rad_s, found.max_acceleration_rad_s2) == ((2.5,) * 3, None)
    assert SerialArm.from_dict(found.to_dict()).to_dict() == found.to_dict()
    rows = "".join(
        f"  {name}: {{has_velocity_limits: {'true' if name == 'j1' else 'false'}, max_velocity: 1,"
        " has_acceleration_limits: true, max_acceleration: 3}\n"
        for name in ("j1", "j2", "j3")
    )
    (tmp_path / "joint_limits.yaml").write_text(f"joint_limits:\n{rows}")
    more = imported(tmp_path, chain(fast, fast, fast)).arm
    assert (more.max_velocity_rad_s, more.max_acceleration_rad_s2) == ((1.0, 2.5, 2.5), (3.0,) * 3)
    assert robot_digest(usual(more)) == robot_digest(usual(found))


def test_elements_that_could_matter_and_are_not_used_are_named(tmp_path: Path) -> None:
    dynamics = '<dynamics damping="1"/>'
    text = chain(LIMIT + dynamics).replace(
        "</robot>", '<transmission name="t"/><loop_joint name="a"/></robot>'
    )
    text = text.replace('<link name="l1">', '<link name="l1"><collision_checking/>')
    assert imported(tmp_path, text).notes == ("two.urdf: not used, collision_checking, loop_joint",)


SRDF = """<robot name="three"><disable_default_collisions link="l3"/>{}
<group name="arm"/><link_sphere_approximation link="l0"/>
<disable_collisions link1="l0" link2="ghost"/></robot>"""


def test_collisions_are_disabled_by_default_and_enabled_again_as_in_moveit(tmp_path: Path) -> None:
    def held_apart(enabled: str) -> tuple[tuple[str, str], ...]:
        (tmp_path / "two.srdf").write_text(SRDF.format(enabled))
        found = imported(tmp_path, chain(radius=0.17))
        assert found.notes == (
            "two.srdf: not used, link_sphere_approximation",
            "two.srdf names links that are not there: ghost",
        )
        return found.arm.touching

    assert held_apart("") == (("l0", "l2"),)
    assert held_apart('<enable_collisions link1="l3" link2="l1"/>') == (("l0", "l2"), ("l1", "l3"))


@pytest.mark.parametrize("is_open", [False, True])
def test_a_housing_of_thin_walls_is_filled(tmp_path: Path, is_open: bool) -> None:
    outer, inner = (trimesh.creation.box(size) for size in ((0.65, 0.65, 0.3), (0.642, 0.642, 0.292)))
    inner.invert()
    outer.update_faces(outer.face_normals[:, 2] > (-0.5 if is_open else -2.0))
    trimesh.util.concatenate([outer] if is_open else [outer, inner]).export(tmp_path / "housing.stl")
    text = chain().replace('<sphere radius="0.06"/>', '<mesh filename="housing.stl"/>', 1)
    found = imported(tmp_path, text)
    assert "link l0 has thin walls or is open: spheres cover its convex hull" in found.notes
    fit = found.fits["l0"]
    assert (fit.missed_m < 0.0025, fit.excess_m < 0.016, fit.spheres < 400) == (True, True, True)


@pytest.mark.parametrize("mimic", ['<mimic joint="j2" multiplier="-1"/>', '<mimic joint="j2" offset="0.5"/>'])
def test_a_joint_of_the_chain_that_mimics_another_is_refused_by_name(tmp_path: Path, mimic: str) -> None:
    text = chain(LIMIT, LIMIT, LIMIT + mimic)
    with pytest.raises(ScenarioError, match=r"j3 cannot follow joint j2.*one that moves.*--lock NAME=VALUE"):
        imported(tmp_path, text)
    # What it advises works, and the follower goes where the leader puts it.
    held = imported(tmp_path, text, locked={"j2": 0.2})
    assert [joint.name for joint in held.arm.joints] == ["j1"]
    follower = next(one for one in held.held if one.name == "j3")
    assert follower.value == pytest.approx(-0.2 if "multiplier" in mimic else 0.7)


def test_joints_beside_the_chain_are_held_as_near_to_zero_as_they_go(tmp_path: Path) -> None:
    finger = FINGER.replace('lower="0" upper="1"', 'lower="0.02" upper="1"')
    other = BRANCH.replace("second", "third").replace("</robot>\n", finger)
    text = with_more(other).replace('<box size="0.04 0.06 0.1"/>', '<sphere radius="0.05"/>')
    text = text.replace('<cylinder radius="0.05" length="0.3"/>', '<sphere radius="0.05"/>')
    found = imported(tmp_path, text, tip="gripper")
    assert {one.name: (one.value, one.why) for one in found.held} == {
        "other": (0.0, "beside the chain"),
        "slide": (0.02, "beside the chain"),
    }


def test_a_floating_base_is_held_where_its_origin_is(tmp_path: Path) -> None:
    free = (
        '<link name="world"/><joint name="free" type="floating"><parent link="world"/><child link="l0"/>'
        '<origin xyz="0 0 0.3"/></joint></robot>'
    )
    text = chain().replace("</robot>", free)
    with pytest.raises(ScenarioError, match=r"free .*got floating; hold it with --lock free=0$"):
        imported(tmp_path, text)
    found = imported(tmp_path, text, locked={"free": 0.0})
    np.testing.assert_allclose(found.arm.joints[0].origin.xyz_m, [0.0, 0.0, 0.6])
    with pytest.raises(ScenarioError, match=r"free .*cannot be held there.*floating; got 1"):
        imported(tmp_path, text, locked={"free": 1.0})


def test_links_are_left_out_by_name_with_all_behind_them(tmp_path: Path) -> None:
    found = imported(tmp_path, chain(), without=("l2",))
    assert [part.name for part in found.arm.parts] == ["l0", "l1"]
    assert "left out by --without: l2, l3" in found.notes


def test_a_large_arm_gets_voxels_that_its_world_can_hold(tmp_path: Path) -> None:
    found = imported(tmp_path, chain(radius=0.3, step=1.2))
    grid = grid_of(found.arm)
    assert grid.voxel_m > 0.025
    assert np.prod(grid.counts) <= MAX_VOXELS
    assert any("the arm is large" in note for note in found.notes)


XACRO = '<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def test_attributes_with_an_undeclared_prefix_are_left_out(tmp_path: Path) -> None:
    found = imported(tmp_path, chain().replace("<limit ", '<limit drake:acceleration="3" '))
    assert len(found.arm.joints) == len(imported(tmp_path, chain()).arm.joints)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("collision>", "inertial>", "no link has a shape"),
        ("</robot>", '<drake:joint name="j9"/></robot>', "no description.*drake:joint"),
        ('<robot name="three">', f'{XACRO}<xacro:gripper parent="l3"/>', r"expand it first.*\.xacro"),
    ],
)
def test_what_is_no_plain_urdf_of_shapes_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        imported(tmp_path, chain().replace(old, new))


# In the style of five makers: properties from YAML with their tags, members, dictionaries, blocks, defaults,
# conditions, lengths, methods and parts of strings, powers, angles in degrees, an expression within another.
MAKERS = """
<xacro:arg name="gripper" default="false"/>
<xacro:property name="config" value="${xacro.load_yaml('$(find maker_arm)/limits.yaml')}"/>
<xacro:property name="sizes" value="${dict(radius=0.1 / 2, names=['a', 'b', 'c'])}"/>
<xacro:property name="limits" value="${config['joint_limits']}" lazy_eval="false"/>
<xacro:property name="file" value="$(find maker_arm)/${'XA-limits'[3:]}.yaml"/>
<xacro:property name="again" value="${load_yaml(file)['joint_limits']}"/>
<xacro:macro name="ball-link" params="name prefix:='' sizes:=^ *inside **more">
  <xacro:unless value="${name in sizes['names']}">${xacro.warning('unknown ' + name)}</xacro:unless>
  <link name="${prefix + '_' if prefix else ''}${name}">
    <collision>
      <xacro:insert_block name="inside"/><geometry><sphere radius="${sizes['radius']}"/></geometry>
    </collision>
    <xacro:insert_block name="more"/>
  </link>
</xacro:macro>
<xacro:macro name="turning" params="name parent child xyz:='0 0 1' at=0.5">
  <xacro:property name="own" value="${limits[name]}"/>
  <joint name="${name}" type="revolute"><parent link="${parent}"/><child link="${child}"/>
    <origin xyz="${xyz.split(' ')[0]} 0 ${2 ** 2 * at / 4}" rpy="0 ${radians(90) - pi / 2} ${sin(0)}"/>
    <axis xyz="${' '.join(['0', '1', '0'])}"/>
    <limit lower="${own.lower}" upper="${min(again[name]['upper'], 2.0)}"/></joint>
</xacro:macro>
<xacro:ball-link name="a"><origin xyz="0 0 0.1"/><more/></xacro:ball-link>
<xacro:ball-link name="b"><origin xyz="0 0 0"/><more/></xacro:ball-link>
<xacro:turning name="j1" parent="a" child="b"/>
<xacro:if value="${'$(arg gripper)' == 'true' and len(sizes['names']) == 3 and not 0 > 1}">
  <xacro:ball-link name="c" prefix="left"><origin/><more/></xacro:ball-link>
  <xacro:turning name="j2" parent="b" child="left_c" xyz="0.2 0 0"
    at="$(eval 1 / 2 if ${'j2' in again} else 0)"/>
</xacro:if>
"""


def test_what_makers_write_in_xacro_is_expanded(tmp_path: Path) -> None:
    package = tmp_path / "maker_arm"
    package.mkdir()
    limits = (
        "joint_limits:\n  j1: {lower: !degrees -90, upper: 1.5}\n  j2: {lower: !radians -pi/4, upper: 9.0}\n"
    )
    (package / "limits.yaml").write_text(limits, encoding="utf-8")
    described(package, f"{XACRO}{MAKERS}</robot>", "arm.xacro")
    top = XACRO + '<xacro:include filename="$(find maker_arm)/arm.xacro"/></robot>'
    path = described(tmp_path, top, "arm.urdf.xacro")
    with pytest.raises(ScenarioError, match=r"package maker_arm is not found.*--package NAME=FOLDER"):
        import_robot(path)
    assert import_robot(path, packages={"maker_arm": package}).arm.dim == 1
    (package / "package.xml").touch()
    arm = import_robot(path, arguments={"gripper": "true"}).arm
    assert [part.name for part in arm.parts] == ["a", "b", "left_c"]
    np.testing.assert_allclose(
        [joint.limits_rad for joint in arm.joints], [(-np.pi / 2, 1.5), (-np.pi / 4, 2.0)]
    )
    np.testing.assert_allclose(arm.joints[1].origin.xyz_m, [0.2, 0.0, 0.5])
    assert arm.parts[0].spheres_m == ((0.0, 0.0, 0.1, 0.05),)


def test_what_xacro_prints_is_shown_up_to_a_bound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = chain().replace('<robot name="three">', XACRO + "${xacro.warning('be aware ' * 2**18)}")
    import_robot(described(tmp_path, text, "made.xacro"))
    shown = capsys.readouterr().err
    assert "be aware" in shown
    assert len(shown) <= 2**20


GLOBALS = "[c for c in ().__class__.__base__.__subclasses__()][0].__init__.__globals__"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<xacro:include filename="{outside}/secret.xacro"/>', "no file of .*secret.xacro"),
        ('<xacro:include filename="link.xacro"/>', "no file of .*link.xacro"),
        ("<link name=\"${{xacro.load_yaml('{outside}/secret.yaml')['a']}}\"/>", "no file of .*secret.yaml"),
        ('<link name="$(env HOME)"/>', "HOME"),
        ("<link name=\"${{''.__class__}}\"/>", "__class__ is not allowed"),
        (f'<link name="${{{{(lambda: {GLOBALS})()}}}}"/>', "Lambda is not allowed"),
        (f'<link name="${{{{{GLOBALS}}}}}"/>', "is not allowed"),
        ('<link name="$(eval lambda: 1)"/>', "Lambda is not allowed"),
        ("<link name=\"$(eval ''.__class__)\"/>", "not allowed|double underscore"),
        ('<link name="${{python.vars(python.type(1))}}"/>', "has no attribute|type|vars"),
        ("<link name=\"${{'a'.format(1)}}\"/>", "format is not allowed"),
        ('<link name="${{str.mro()}}"/>', "mro is not allowed"),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "recursion"),
        ('<xacro:include filename="pipe.xacro"/>', "no file of .*pipe.xacro"),
        ('<link name="${{9**9**9}}"/>', "exponent"),
        ('<link name="${{max(range(9**9 * 99))}}"/>', "no end within 10 s of a core"),
    ],
)
@pytest.mark.slow
def test_xacro_reads_nothing_outside_its_packages_and_ends(tmp_path: Path, text: str, message: str) -> None:
    outside, folder = tmp_path / "outside", tmp_path / "arm"
    outside.mkdir()
    folder.mkdir()
    (outside / "secret.xacro").write_text(XACRO + '<link name="secret"/></robot>', encoding="utf-8")
    (outside / "secret.yaml").write_text("a: secret", encoding="utf-8")
    (folder / "link.xacro").symlink_to(outside / "secret.xacro")
    os.mkfifo(folder / "pipe.xacro")
    path = described(folder, XACRO + text.format(outside=outside) + "</robot>", "made.xacro")
    with pytest.raises(ScenarioError, match=rf"made\.xacro.*({message})"):
        import_robot(path)
