"""What Tune knows a stage's function by."""

from ray.tune.experiment import Experiment

from training.config import ResourceConfig
from training.trials.launch import TrialRequest, bind


def known_as(folder):
    def look(trial):
        del trial

    trial = TrialRequest(folder / "stage" / "vae")
    bound = bind(look, {trial.name: trial}, {}, ResourceConfig())
    assert bound.__name__ == "look"
    return Experiment.get_trainable_name(bound)


def test_no_two_jobs_of_one_driver_share_a_function(tmp_path):
    # Tune keeps the last function of a name, for every job that a sweep runs side by side.
    assert known_as(tmp_path / "one") != known_as(tmp_path / "two")
    assert known_as(tmp_path / "one") == known_as(tmp_path / "one")
