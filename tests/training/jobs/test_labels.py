"""What runs of jobs are called and show."""

import json

import pytest

from cspace.worlds import default_world
from tests.fakes.registry import FakeTracking
from training.config import TrainConfig
from training.jobs.job import LONGEST, job_label, log_configuration, shown_tags, world_tag


@pytest.fixture
def run():
    tracking = FakeTracking()
    log = tracking.start("e", "job")
    return log, tracking.runs[log.run_id]


def test_a_job_goes_by_its_name_or_by_its_preset():
    config = TrainConfig.load("paper", ["seed=3"])
    assert job_label(config, "arm-1") == "arm-1, seed 3"
    assert job_label(config, None) == "paper, seed 3"
    assert shown_tags(config, None, "local") == {"stage": "local", "job": "", "preset": "paper"}
    assert world_tag(default_world(), None) == {"world": "planar, two-link"}


def test_settings_are_parameters_one_each_and_a_file_has_all_of_them(run):
    log, kept = run
    config = TrainConfig.load("quickstart", [f"start_from={'x' * (LONGEST + 1)}"])
    log_configuration(log, config)
    assert kept.params["local.steps"] == str(config.local.steps)
    assert "start_from" not in kept.params
    assert not any(value == "None" or len(value) > LONGEST for value in kept.params.values())
    assert json.loads(kept.artifacts["configuration.json"]) == config.to_dict()
