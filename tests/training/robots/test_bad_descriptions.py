import re
from pathlib import Path

import pytest

from cspace.errors import ScenarioError
from tests.training.robots.descriptions import BRANCH, TWO_LINKS, described, with_more
from training.robots.__main__ import main
from training.robots.description import found_file
from training.robots.importing import Request, import_robot

SLIDING = TWO_LINKS.replace('"continuous"', '"prismatic"')
LIMITS = 'lower="-2" upper="2"'


def shoulder(limits: str) -> str:
    return TWO_LINKS.replace(LIMITS, limits)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SLIDING, "elbow does not fit a serial arm.*got prismatic.*--lock elbow=VALUE"),
        (SLIDING.replace('"prismatic"', '"planar"'), "got planar.*--lock elbow=0"),
        (with_more(BRANCH), "tip of the chain is not clear.*gripper.*second.*--tip"),
        (shoulder(""), "limits of joint shoulder.*got none.*--limit shoulder="),
        (shoulder('lower="-2" upper="-2"'), "shoulder do not fit.*--lock shoulder=VALUE"),
        (
            shoulder('lower="-170" upper="170"'),
            "shoulder .*like degrees; give --limit shoulder=-2.9671,2.9671",
        ),
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
        import_robot(Request(described(tmp_path, text)))


def test_names_that_the_description_does_not_have_are_refused(tmp_path: Path) -> None:
    limits = {"limits": {"wrist": (0.0, 1.0)}}
    for options in ({"locked": {"wrist": 0.0}}, limits, {"tip": "hand"}, {"kept": (("a", "base"),)}):
        with pytest.raises(ScenarioError, match=r"unknown|not clear"):
            import_robot(Request(described(tmp_path), **options))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["nowhere.urdf"], "cannot be read.*No such file.*path of a URDF"),
        (["two.urdf", "--lock", "elbow"], "--lock does not fit; expected NAME=VALUE"),
        (["two.urdf", "--limit", "elbow=1"], "--limit does not fit; expected a finite number"),
        (["two.urdf", "--slack-mm", "inf"], "at most 1 m"),
        (["two.urdf", "--excess-mm", "nan"], "0.001 m or more"),
        (["two.urdf", "--ready", "0,nan"], "--ready does not fit; expected a finite number"),
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
    assert found_file("../meshes/a.stl", mesh.parent, {}).samefile(mesh)
    assert found_file(f"file://{mesh}", folder, {}) == mesh
    with pytest.raises(ScenarioError, match=r"a mesh is not found.*--package other=FOLDER"):
        found_file("package://other/meshes/a.stl", folder, {})


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
    with pytest.raises(ScenarioError, match=r"outside the robot's folder.*secret\.stl.*--package NAME="):
        found_file(name, folder, {})
    if not name.startswith("package"):
        assert found_file(name, folder, {"top": tmp_path}).samefile(tmp_path / "secret.stl")


@pytest.mark.parametrize(
    "name",
    [
        "package://etc/hostname",
        "package://../secret.stl",
        "package://other/secret.stl",
        "a\0b.stl",
        "a" * 300 + ".stl",
    ],
)
def test_names_that_are_no_mesh_s_are_not_found(tmp_path: Path, name: str) -> None:
    for place in (tmp_path / "secret.stl", tmp_path / "other" / "secret.stl"):
        place.parent.mkdir(exist_ok=True)
        place.touch()
    (tmp_path / "arm").mkdir()
    with pytest.raises(ScenarioError, match="a mesh is not found"):
        found_file(name, tmp_path / "arm", {})
