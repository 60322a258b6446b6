from pathlib import Path
from types import SimpleNamespace

import torch

from training.config import load_config
from training.models.checkpoint import Progress, save_checkpoint, seeded_initialisation
from training.trials.launch import FINISHED, METRICS, Outcomes, TrialFolder, TrialRequest, read_outcome
from training.trials.search import claimed

STAGES = {
    "pictures": ("vae", "validity"),
    "gate": ("gate",),
    "local": tuple(f"local-{index}" for index in range(8)),
    "global": ("global",),
    "models": ("wgan", "flow"),
}


def requests(seed: int, folder: Path) -> list[TrialRequest]:
    job = SimpleNamespace(
        config=load_config("smoke", [f"seed={seed}"]),
        folder=folder,
        start_folder=None,
        name=None,
        run=SimpleNamespace(run_id="0" * 32),
        child=lambda name: name,
    )
    return [TrialRequest.of(job, stage, name) for stage, names in STAGES.items() for name in names]


def test_no_two_trials_have_one_seed_in_whatever_job(tmp_path: Path) -> None:
    seeds = [request.seed for seed in range(20) for request in requests(seed, tmp_path)]
    assert len(set(seeds)) == len(seeds)
    assert seeds == [request.seed for seed in range(20) for request in requests(seed, tmp_path)]


def test_a_trial_of_a_search_claims_no_gpu_that_it_would_not_use() -> None:
    resources = load_config("smoke", ["resources.gpus_per_trial=1", "resources.cpus_per_trial=2"]).resources
    assert claimed(resources) == {"cpu": 2.0, "gpu": 0.0}


def test_networks_start_from_other_numbers_than_the_training_draws() -> None:
    with seeded_initialisation(7):
        weights = torch.randn(16)
    assert not torch.isin(weights, torch.randn(1000, generator=torch.Generator().manual_seed(7))).any()


def test_an_outcome_keeps_every_metric_that_the_trial_reported_and_none_of_tunes(tmp_path: Path) -> None:
    from tests.training.models.builders import tiny_module

    request = TrialRequest(tmp_path / "pictures" / "validity")
    save_checkpoint(TrialFolder(request.folder).folder / "step-000000004", tiny_module(), Progress(4, "run"))
    reported = {"step": 4.0, "validity_loss": 0.25, "hazard_loss": 0.5, "a_loss_to_come": 0.125}
    result = {
        METRICS: reported,
        FINISHED: True,
        "timestamp": 20,
        "time_total_s": 5.0,
        "training_iteration": 3,
    }
    trial = SimpleNamespace(config={"trial": "validity"})
    Outcomes(request.stage).on_trial_result(1, [trial], trial, result)
    outcome = read_outcome(request)
    assert outcome is not None
    assert outcome.metrics == {"validity_loss": 0.25, "hazard_loss": 0.5, "a_loss_to_come": 0.125}
    assert (outcome.started_s, outcome.ended_s) == (15.0, 20.0)
