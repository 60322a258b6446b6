import numpy as np
import pytest

from cspace.dataset import write_dataset
from cspace.errors import ConfigError
from training import path_train
from training.cluster_train import COMMAND
from training.config import PathTrainConfig, TrainConfig
from training.config_section import described

OWN_ROBOT = "data.robot.link_lengths_m=[1.0, 1.0]"


def test_the_paper_preset_is_the_papers_numbers():
    config = TrainConfig.load("paper")
    assert (config.data.scenario_count, config.data.free_per_scenario) == (100, 10_000)
    assert (config.local.means, config.local.sigma, config.local.smooth_maximum) == (4, 0.025, 0.1)
    assert (config.global_.means, config.global_.sigma, config.global_.local_critic_weight) == (1, 0.0, 1.0)
    assert (config.local.penalty, config.local.critic_condition) == ("two_sided", "projection")
    assert (config.vae.latent_dim, config.local.critic_steps, config.local.batch_size) == (512, 5, 512)


def test_the_papers_columns_differ_from_its_preset_only_where_they_must():
    def flat(values, prefix=""):
        rows = {}
        for key, value in values.items():
            rows |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        return rows

    def changes(preset):
        base, column = (flat(TrainConfig.load(name).to_dict()) for name in ("paper", preset))
        return {key: value for key, value in column.items() if base.get(key) != value and key != "preset"}

    alone = {"clusters.count": 1, "clusters.form": "wgan_gp"}
    means = {"global.means": 4, "global.sigma": 0.025, "global.smooth_maximum": 0.1}
    assert changes("paper_single") == alone
    assert changes("paper_means") == alone | means
    assert changes("paper_joint") == {
        "clusters.count": 1,
        "clusters.form": "joint",
        "global.reconstruction_weight": 1.0,
        "vae.batch_size": 16,
    }


@pytest.mark.parametrize(
    ("preset", "overrides", "says"),
    [
        ("nothing", [], "quickstart"),
        ("../presets/quickstart", [], "quickstart"),
        ("quickstart", ["gate.step=7"], r"gate\.step"),
        ("quickstart", ["gate.steps=many"], r"gate\.steps"),
        ("quickstart", ["gate.steps"], r"key\.sub=value"),
        ("quickstart", ["seed.deep=1"], "seed"),
        ("quickstart", ["gate.steps=[1"], "YAML"),
        ("paper_joint", ["global.critic_condition=latent"], "projection"),
        ("paper_joint", ["vae.checkpoint=/somewhere"], "own encoder"),
        ("paper_joint", ["data.robot=panda"], "pictures of a plane"),
        ("smoke", ["robot_name=arm-7"], "another robot"),
        ("smoke", ["robot_name=three-link"], "another robot"),
        ("smoke", [OWN_ROBOT, "robot_name=two-link"], "another robot"),
        (
            "panda",
            ["local.generator_lookups={points_per_link: 12, side_m: 0.1}"],
            r"generator_lookups\.points_per_link",
        ),
        ("panda", ["local.critic_lookups={groups: 64}"], r"local\.critic_lookups\.groups"),
        ("smoke_mixture", ["local.generator_lookups={groups: 64}"], r"local\.generator_lookups\.groups"),
    ],
)
def test_settings_that_do_not_fit_are_refused_before_anything_starts(preset, overrides, says):
    with pytest.raises(ConfigError, match=says):
        TrainConfig.load(preset, overrides)


@pytest.mark.parametrize(
    ("kind", "preset"),
    [(kind, preset) for kind in (TrainConfig, PathTrainConfig) for preset in kind.presets()],
)
def test_every_key_of_every_preset_has_a_description(kind, preset):
    assert [line for line in described(kind.load(preset)) if "  # " not in line] == []


def test_the_command_prints_its_configuration(capsys):
    assert COMMAND.main(["--preset", "smoke", "--print-config"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith('preset="smoke"') for line in lines)
    assert any(line.startswith("resources.max_failures=2 ") and "# after so many" in line for line in lines)
    assert any(line.startswith("global.local_critic_weight=") for line in lines)


def test_the_command_ends_with_two_on_settings_that_are_wrong_missing_or_too_many(capsys, monkeypatch):
    assert COMMAND.main(["--set", "nonsense=1"]) == 2
    assert "nonsense" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        COMMAND.main(["--resume", "abc", "--set", "seed=1"])
    assert "--resume" in capsys.readouterr().err
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    assert COMMAND.main(["--preset", "smoke"]) == 2
    assert "MLFLOW_TRACKING_URI" in capsys.readouterr().err


def test_a_trial_claims_what_the_configuration_says_and_no_memory_unless_it_does():
    assert TrainConfig.load("smoke").resources.of_a_trial() == {"cpu": 1.0, "gpu": 0.0}
    half = [
        "resources.gpus_per_trial=0.5",
        "resources.cpus_per_trial=2",
        "resources.memory_mb_per_trial=1500",
    ]
    claimed = TrainConfig.load("smoke", half).resources.of_a_trial()
    assert claimed == {"cpu": 2.0, "gpu": 0.5, "memory": 1500 * 1024 * 1024}
    # It computes on as many threads.
    for cpus, threads in ((0.5, 1), (3.5, 3)):
        assert TrainConfig.load("smoke", [f"resources.cpus_per_trial={cpus}"]).resources.threads == threads


def test_a_robots_name_is_recorded_where_it_is_given_and_changes_no_data_set():
    plain, named = (
        TrainConfig.load("smoke", [OWN_ROBOT]),
        TrainConfig.load("smoke", [OWN_ROBOT, "robot_name=arm-7"]),
    )
    assert "robot_name" not in plain.to_dict()
    assert named.to_dict() == {**plain.to_dict(), "robot_name": "arm-7"}
    assert named.data.key == plain.data.key
    assert TrainConfig.from_dict(plain.to_dict()) == plain


@pytest.mark.parametrize(
    ("command", "key", "path"),
    [
        (COMMAND, "data_folder", "./mine"),
        (COMMAND, "vae.checkpoint", "~/mine"),
        (path_train.COMMAND, "data_folder", "mine"),
        (path_train.COMMAND, "source", "build/bundle"),
    ],
)
def test_a_path_that_is_not_absolute_is_refused_before_anything_starts(command, key, path, capsys):
    assert command.main(["--set", f"{key}={path}", "--print-config"]) == 2
    message = capsys.readouterr().err
    assert f"{key} does not fit" in message
    assert "absolute" in message
    assert path in message


@pytest.mark.parametrize("source", ["panda-sampler@champion", "cspace-sampler/3", "/somewhere/bundle"])
def test_the_source_of_paths_is_a_registered_version_or_an_absolute_folder(source):
    assert PathTrainConfig.load("paths", [f"source={source}"]).source == source


def test_settings_are_held_against_the_robot_of_a_data_set_too(tmp_path):
    world = TrainConfig.load("panda").data.world
    images = np.zeros((1, *world.sensor.picture_shape), dtype=np.uint8)
    folder = tmp_path / "panda"
    free = [world.space.sample_uniform(np.random.default_rng(0), 1)]
    write_dataset(folder, world=world, images=images, free=free, generator={})
    with pytest.raises(ConfigError, match=r"local\.critic_lookups\.points_per_link does not fit the robot"):
        TrainConfig.load("panda", [f"data_folder={folder}", "local.critic_lookups.points_per_link=4"])
    with pytest.raises(ConfigError, match="not read along links"):
        TrainConfig.load("smoke", [f"data_folder={folder}"])
