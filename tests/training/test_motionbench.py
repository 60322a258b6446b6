import hashlib
import io
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from cspace.errors import DatasetError, ServiceError
from cspace.simulator import Split
from cspace.worlds.spatial.benchmark import BENCH_FAMILIES, NUMBERS, problems
from training import motionbench

INSIDE = "vamp_planner-0.6.4/resources/panda/problems.tar.bz2"
JOINTS = [f"panda_joint{number}" for number in range(1, 8)]
HALF = 0.5**0.5


# Instead of a hundred problems in each family.
FEW = {Split.VALIDATION: range(1, 3), Split.TEST: range(3, 6)}


@pytest.fixture(scope="module", autouse=True)
def few_problems() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for split, numbers in FEW.items():
            patch.setitem(NUMBERS, split, numbers)
        yield


UR5 = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


def scene(number: int) -> dict[str, object]:
    upright = {"position": [0.1, 0.2, number / 100], "orientation": [0, 0, 0, 1]}
    turned = {"position": [1, 0, 0], "orientation": [0, 0, HALF, HALF]}
    can = {"id": "can", "primitives": [{"type": "cylinder", "dimensions": [0.12, 0.03]}]}
    top = {"id": "top", "pose": turned, "primitives": [{"type": "box", "dimensions": [0.2, 0.4, 0.6]}]}
    return {"world": {"collision_objects": [one | {"primitive_poses": [upright]} for one in (can, top)]}}


def request(number: int) -> dict[str, object]:
    # In another order than the arm's.
    goal = [{"joint_name": name, "position": index + 0.12345678} for index, name in enumerate(JOINTS)][::-1]
    start = {"name": ["finger", *JOINTS], "position": [0.065, *np.linspace(0, number, 7).tolist()]}
    return {"start_state": {"joint_state": start}, "goal_constraints": [{"joint_constraints": goal}]}


TEXTS = [(yaml.safe_dump(scene(n)).encode(), yaml.safe_dump(request(n)).encode()) for n in range(1, 6)]


def packed(files: dict[str, bytes], how: str) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode=how) as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return out.getvalue()


def made(
    folder: Path,
    changes: dict[str, bytes | None] | None = None,
    inside: str = INSIDE,
    more: dict[str, bytes] | None = None,
) -> tuple[Path, str]:
    files: dict[str, bytes | None] = {"problems/notes.txt": b"no problem"}
    for family in BENCH_FAMILIES:
        for number, (first, second) in enumerate(TEXTS, 1):
            files[f"problems/{family}_panda/scene{number:04}.yaml"] = first
            files[f"problems/{family}_panda/request{number:04}.yaml"] = second
    kept = {name: data for name, data in (files | (changes or {})).items() if data is not None}
    project = b'[build-system]\nrequires = []\nbuild-backend = "scikit_build_core.build"\n'
    outer = {
        "vamp_planner-0.6.4/pyproject.toml": project,
        "vamp_planner-0.6.4/PKG-INFO": b"Metadata-Version: 2.1\nName: vamp-planner\nVersion: 0.6.4\n",
        inside: packed(kept, "w:bz2"),
        **(more or {}),
    }
    path = folder / "vamp_planner-0.6.4.tar.gz"
    path.write_bytes(packed(outer, "w:gz"))
    return path, hashlib.sha256(path.read_bytes()).hexdigest()


def offline(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let pip find packages in a folder alone."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    return made(tmp_path_factory.mktemp("sound"))


def test_an_archive_becomes_problems(sound: tuple[Path, str]) -> None:
    splits = motionbench.read_archive(*sound)
    assert {split: len(found) for split, found in splits.items()} == {Split.VALIDATION: 14, Split.TEST: 21}
    problem = splits[Split.TEST][0]
    assert (problem.family, problem.number) == ("bookshelf_small", 3)
    assert problem.start == tuple(np.round(np.linspace(0, 3, 7), 6).tolist())
    assert problem.goal == tuple(index + 0.123457 for index in range(7))
    (box,), (cylinder,) = problem.obstacles.boxes, problem.obstacles.cylinders
    assert (cylinder.radius_m, cylinder.half_length_m) == (0.03, 0.06)
    assert cylinder.pose[2] == (0.0, 0.0, 1.0, 0.03)
    assert box.half_m == (0.1, 0.2, 0.3)
    # A quarter turn about z takes (0.1, 0.2) to (-0.2, 0.1).
    assert box.pose == ((0, -1, 0, 0.8), (1, 0, 0, 0.1), (0, 0, 1, 0.03), (0, 0, 0, 1))


def test_the_command_fetches_by_pip_without_building(
    sound: tuple[Path, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    offline(monkeypatch, sound[0].parent)
    monkeypatch.setattr(motionbench, "SHA256", sound[1])
    assert motionbench.main(["fetch", "--out", str(tmp_path / "out")]) == 0
    output = capsys.readouterr().out
    assert "validation.json.gz: bookshelf_small 2," in output
    assert "test.json.gz: bookshelf_small 3," in output
    assert len(problems(Split.TEST, tmp_path / "out")) == 21
    assert len(problems(Split.VALIDATION, tmp_path / "out")) == 14


def test_an_archive_with_another_digest_is_refused(
    sound: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = tmp_path / "damaged.tar.gz"
    damaged.write_bytes(sound[0].read_bytes()[:-1])
    with pytest.raises(DatasetError, match="SHA-256"):
        motionbench.read_archive(damaged, sound[1])
    # Sound, but not the one that the problems are taken from.
    assert motionbench.main(["fetch", "--archive", str(sound[0]), "--out", str(tmp_path / "out")]) == 2
    assert "damaged or another" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_problems_of_the_ur5_come_with_its_description(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = dict(zip(JOINTS, [*(f"{name}_joint" for name in UR5), "knuckle"], strict=True))

    def renamed(text: bytes) -> bytes:
        for old, new in names.items():
            text = text.replace(old.encode(), new.encode())
        return text

    changes = {
        f"problems/{family}_ur5/{kind}{number:04}.yaml": renamed(text)
        for family in BENCH_FAMILIES
        for number, both in enumerate(TEXTS, 1)
        for kind, text in zip(("scene", "request"), both, strict=True)
    }
    folder = "vamp_planner-0.6.4/resources/ur5"
    more = {f"{folder}/ur5.urdf": b"<robot/>", f"{folder}/meshes/ur5/base.stl": b"solid", "../evil": b""}
    path, sha256 = made(tmp_path, changes, f"{folder}/problems.tar.bz2", more)
    monkeypatch.setattr(motionbench, "SHA256", sha256)
    asked = ["fetch", "--robot", "ur5", "--archive", str(path), "--out", str(tmp_path / "out")]
    assert motionbench.main(asked) == motionbench.main(asked) == 0
    (first, *_) = problems(Split.VALIDATION, tmp_path / "out")
    assert first.goal == tuple(index + 0.123457 for index in range(6))
    found = sorted(one for one in (tmp_path / "out" / "description").rglob("*") if one.is_file())
    assert [one.name for one in found] == ["base.stl", "ur5.urdf"]
    assert not (tmp_path / "evil").exists()


def test_a_fetch_that_pip_refuses_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offline(monkeypatch, tmp_path)
    refused = pytest.raises(ServiceError, match=r"No matching distribution.*--archive")
    with refused, motionbench.downloaded("0" * 64):
        pass
