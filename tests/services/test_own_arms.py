"""A robot's file, as ``python -m training.robots import`` writes it, wherever a robot is named."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cspace.errors import ConfigError, ScenarioError
from cspace.query import SampleQuery
from cspace.worlds import named_world, robot_digest
from cspace.worlds.spatial.world import shipped, usual
from services.local.quickstart import import_arm, tour_of_arm
from services.local.stack import Settings
from services.names import label
from services.planner.__main__ import main
from services.planner.planning import SampleRequest
from services.scene_files import read_scene_file
from tests.training.robots.descriptions import TWO_LINKS
from training.config import TrainConfig
from training.data.__main__ import main as data_command

ARM = replace(shipped("ur5"), name="Bench_Arm 5")
DIGEST = robot_digest(usual(ARM))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(ARM.to_dict()))
    return path


@pytest.mark.parametrize(
    ("name", "expected"),
    [("Bench_Arm 5", "bench-arm-5"), ("panda", None), ("", None), ("arm-path", None), ("\u0443", None)],
    ids=["own", "an example's", "none", "of path models", "no letter that fits"],
)
def test_a_robot_is_called_as_its_description_says_where_no_other_is(name: str, expected: str | None) -> None:
    assert label(usual(replace(ARM, name=name))) == expected
    assert label(usual(shipped("ur5"))) is None


def test_a_job_takes_a_robots_file(file: Path) -> None:
    config = TrainConfig.load("panda_quick", [f"data.robot={file}"])
    assert robot_digest(config.world) == DIGEST
    # What is recorded needs no file.
    assert config.to_dict()["data"]["robot"]["name"] == ARM.name


def test_the_planner_takes_a_robots_file_and_asks_for_its_own_model(file: Path) -> None:
    request = SampleRequest(SampleQuery(3, 0)).of_robot(named_world(str(file)))
    assert (request.model, request.or_uniform) == ("bench-arm-5-sampler", True)
    assert main(["--robot", "pandora"]) == 2


def test_a_scene_file_names_a_robots_file_beside_it(file: Path) -> None:
    scene = file.with_name("scene.yaml")
    scene.write_text(f"world: spatial\nrobot: {file.name}\nobstacles: []\n")
    assert robot_digest(read_scene_file(scene).world) == DIGEST
    scene.write_text("world: spatial\nobstacles: []\nrobot: gone.json\n")
    with pytest.raises(ScenarioError, match=r"scene\.yaml: the robot is unknown"):
        read_scene_file(scene)


def test_data_of_an_arm_have_the_usual_amounts_of_arms(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    requested = []
    monkeypatch.setattr("training.data.generate.generate", lambda config, _: requested.append(config))
    command = ["generate", str(tmp_path / "data"), "--arm", str(file)]
    assert data_command(command) == data_command([*command, "--scenario-count", "3000"]) == 0
    first, second = requested
    assert (first.scenario_count, first.extra_image_count, first.proposals_per_scenario) == (600, 0, 384)
    assert (second.scenario_count, second.extra_image_count) == (3000, 0)


def test_an_own_arms_job_goes_on_under_its_name_and_plans_with_its_own_robot(file: Path) -> None:
    tour = tour_of_arm(file)
    assert f"--job arm-bench-arm-5-{DIGEST[:8]} --set data.robot={file}" in tour.train
    assert tour.robot == str(file)
    file.write_text(json.dumps(replace(ARM, name="panda").to_dict()))
    with pytest.raises(ScenarioError, match="--name"):
        tour_of_arm(file)


def test_a_description_that_is_refused_ends_the_command_with_the_imports_own_words(tmp_path: Path) -> None:
    lines: list[str] = []
    settings = Settings(home=tmp_path / "home")
    with pytest.raises(ConfigError, match="was not imported"):
        import_arm(settings, tmp_path / "none.urdf", ["--name", "bench"], lines.append)
    assert any("none.urdf" in line and "error" in line for line in lines)


def test_an_import_names_its_files_as_the_model_and_another_name_leaves_them(
    tmp_path: Path,
) -> None:
    settings, urdf = Settings(home=tmp_path / "home"), tmp_path / "two.urdf"
    urdf.write_text(TWO_LINKS)
    files = [import_arm(settings, urdf, ["--name", name], lambda _: None) for name in ("first", "second")]
    assert [file.name for file in files] == ["first.json", "second.json"]
    assert sorted((settings.home / "arms").iterdir()) == sorted(files)
