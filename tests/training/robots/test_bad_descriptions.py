import re
from pathlib import Path
from typing import Any

import pytest
import trimesh

from cspace.errors import ScenarioError
from tests.training.robots.descriptions import BRANCH, TWO_LINKS, described, with_more
from training.robots.__main__ import main
from training.robots.description import found_file
from training.robots.importing import import_robot

SLIDING = TWO_LINKS.replace('"continuous"', '"prismatic"')
LIMITS = 'lower="-2" upper="2"'


def shoulder(limits: str) -> str:
    return TWO_LINKS.replace(LIMITS, limits)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TWO_LINKS.replace('"2 0 0"', '"0 0 0"'), "axis of joint elbow"),
        (TWO_LINKS.replace('"2 0 0"', '"0 0 nan"'), "axis of joint elbow"),
        (TWO_LINKS.replace('"2 0 0"', '"2 0"'), "axis of joint elbow"),
        (TWO_LINKS.replace('"0.12"', '"-1"'), "base.*a sphere with sizes"),
        (TWO_LINKS.replace('"0.05" length="0.3"', '"1e-9" length="1e6"'), "upper.*a cylinder with sizes"),
        (TWO_LINKS.replace('"0.04 0.06 0.1"', '"0.1 0.1"'), "link lower.*a box with sizes"),
        (TWO_LINKS.replace('xyz="0 0 0.25"', 'xyz="0 0 nan"'), "an <origin> in .* does not fit"),
        (TWO_LINKS.replace('<sphere radius="0.12"/>', "<mesh/>"), "a mesh is not found"),
        (TWO_LINKS.replace('child link="upper"', 'child link="missing"'), "no tree of links"),
        (TWO_LINKS.replace('child link="gripper"', 'child link="upper"'), "no tree of links"),
        (TWO_LINKS.replace('parent link="base"', 'parent link="gripper"'), "no tree of links"),
        (with_more('<link name="base"/></robot>'), "no tree of links"),
        (TWO_LINKS.replace("<sphere", "<capsule"), "sphere or mesh, .*capsule"),
        (TWO_LINKS.replace('<parent link="base"/>', ""), "parent and child"),
        ("<robot", "is no description"),
        ("<sdf/>", "the root <robot>; got <sdf>"),
    ],
)
def test_descriptions_that_cannot_be_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        import_robot(described(tmp_path, text))


ROD = """
  <link name="rod"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="follows" type="continuous">
    <parent link="upper"/><child link="rod"/><axis xyz="0 1 0"/><mimic joint="elbow" multiplier="-1"/>
  </joint>
</robot>
"""
MESHED = TWO_LINKS.replace('<sphere radius="0.12"/>', '<mesh filename="package://other/box.stl"/>')


@pytest.mark.parametrize(
    ("text", "message", "remedy"),
    [
        (SLIDING, "elbow does not fit.*got prismatic.*--lock elbow=VALUE", {"locked": {"elbow": 0.1}}),
        (
            SLIDING.replace('"pris', '"pla').replace('atic"', 'ar"'),
            "--lock elbow=0",
            {"locked": {"elbow": 0}},
        ),
        (with_more(BRANCH), "last ones are gripper, second; got several; name .*--tip", {"tip": "gripper"}),
        (shoulder(""), "shoulder.*got none.*--limit shoulder=LOW", {"limits": {"shoulder": (-1.0, 1.0)}}),
        (shoulder(""), "--limit shoulder=none", {"limits": {"shoulder": None}}),
        (shoulder('lower="-2" upper="-2"'), "--lock shoulder=VALUE", {"locked": {"shoulder": -2.0}}),
        (
            shoulder('lower="-170" upper="170"'),
            "degrees; give --limit shoulder=-2.9671,2.9671",
            {"limits": {"shoulder": (-2.9671, 2.9671)}},
        ),
        (with_more(ROD), "follows cannot follow joint elbow.*--without rod", {"without": ("rod",)}),
        (with_more(ROD), "--lock NAME=VALUE", {"locked": {"elbow": 0.5}}),
        (MESHED, "a mesh is not found.*--package other=FOLDER", {"packages": {"other": "meshes"}}),
    ],
)
def test_what_a_message_advises_works(
    tmp_path: Path, text: str, message: str, remedy: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("meshes").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.1)).export("meshes/box.stl")
    urdf = described(tmp_path, text)
    with pytest.raises(ScenarioError, match=message):
        import_robot(urdf)
    if "packages" in remedy:
        remedy = {"packages": {"other": tmp_path / "meshes"}}
    assert import_robot(urdf, **remedy).arm.dim >= 1


def test_a_pointer_of_git_lfs_is_told_and_pulling_it_helps(tmp_path: Path) -> None:
    mesh = tmp_path / "box.stl"
    mesh.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 684\n")
    urdf = described(tmp_path, MESHED.replace("package://other/", ""))
    with pytest.raises(ScenarioError, match=r"box\.stl is a pointer of Git LFS.*git lfs pull"):
        import_robot(urdf)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(mesh)
    assert import_robot(urdf).arm.parts[0].name == "base"


def test_names_that_the_description_does_not_have_are_refused(tmp_path: Path) -> None:
    limits = {"limits": {"wrist": (0.0, 1.0)}}
    for options in ({"locked": {"wrist": 0.0}}, limits, {"tip": "hand"}, {"kept": (("a", "base"),)}):
        with pytest.raises(ScenarioError, match=r"unknown|not clear"):
            import_robot(described(tmp_path), **options)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["nowhere.urdf"], "cannot be read.*No such file.*path of a URDF"),
        (["two.urdf", "--slack-mm", "inf"], "at most 1 m"),
        (["two.urdf", "--excess-mm", "nan"], "0.001 m or more"),
        (["two.urdf", "--ready", "0"], "the arm cannot wait there; expected 2 angles"),
        (["two.urdf", "--ready", "2.5,0"], "the arm cannot wait there; expected shoulder from -2 to 2 rad"),
    ],
)
def test_the_command_ends_with_one_line_and_2(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    more: list[str],
    message: str,
) -> None:
    described(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["import", *more, "--out", "out.json"]) == 2
    message_shown = capsys.readouterr().err
    assert message_shown.count("\n") == 1
    assert re.search(message, message_shown)
    assert not Path("out.json").exists()


def test_meshes_are_found_in_packages(tmp_path: Path) -> None:
    mesh = tmp_path / "share" / "arm" / "meshes" / "a.stl"
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    (tmp_path / "share" / "arm" / "package.xml").touch()
    folder = tmp_path / "share" / "arm" / "urdf"
    assert found_file("package://arm/meshes/a.stl", folder, {}) == mesh
    assert found_file("package://other/meshes/a.stl", folder, {"other": mesh.parents[1]}) == mesh
    for address in ("package://other//meshes/a.stl", "model://other/meshes/a.stl"):
        assert found_file(address, folder, {"other": mesh.parents[1]}) == mesh
    assert found_file("../meshes/a.stl", mesh.parent, {}).samefile(mesh)
    assert found_file(f"file://{mesh}", folder, {}) == mesh
    with pytest.raises(ScenarioError, match=r"a mesh is not found.*--package other=FOLDER"):
        found_file("package://other/meshes/a.stl", folder, {})
    # A package has the name that its package.xml says, wherever it was cloned to.
    (tmp_path / "share" / "arm" / "package.xml").write_text("<package><name>other</name></package>")
    beside = tmp_path / "share" / "robot"
    beside.mkdir()
    (beside / "package.xml").touch()
    for place in (folder, beside / "urdf"):
        assert found_file("package://other/meshes/a.stl", place, {}) == mesh
    assert found_file("package://arm/meshes/a.stl", folder, {}) == mesh


@pytest.mark.parametrize(
    "name",
    [
        "../secret.stl",
        "{top}/secret.stl",
        "file://{top}/secret.stl",
        "package://arm/../secret.stl",
        "link.stl",
    ],
)
def test_meshes_outside_the_robots_folder_are_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "arm"
    folder.mkdir()
    (tmp_path / "secret.stl").touch()
    (folder / "link.stl").symlink_to(tmp_path / "secret.stl")
    name = name.format(top=tmp_path)
    with pytest.raises(ScenarioError, match=r"not found in the robot's folders.*--package (NAME|arm)="):
        found_file(name, folder, {})
    if not name.startswith("package"):
        assert found_file(name, folder, {"top": tmp_path}).samefile(tmp_path / "secret.stl")
