from pathlib import Path
from types import SimpleNamespace

import torch

from training.config import TrainConfig
from training.jobs.launch import TrialRequest
from training.models.checkpoint import seeded_initialisation

STAGES = {
    "pictures": ("vae", "validity"),
    "gate": ("gate",),
    "local": tuple(f"local-{index}" for index in range(8)),
    "global": ("global",),
    "models": ("wgan",),
}


def requests(seed: int, folder: Path) -> list[TrialRequest]:
    job = SimpleNamespace(
        config=TrainConfig.load("smoke", [f"seed={seed}"]),
        folder=folder,
        name=None,
        environment=SimpleNamespace(tracking_uri="", patience_s=0.0),
        run=SimpleNamespace(run_id="0" * 32),
        child=lambda name: name,
    )
    return [TrialRequest.of(job, stage, name) for stage, names in STAGES.items() for name in names]


def test_no_two_trials_have_one_seed_in_whatever_job(tmp_path: Path) -> None:
    seeds = [request.seed for seed in range(6) for request in requests(seed, tmp_path)]
    assert len(set(seeds)) == len(seeds)
    again = [request.seed for request in requests(0, tmp_path)]
    assert seeds[: len(again)] == again


def test_networks_start_from_other_numbers_than_the_training_draws() -> None:
    with seeded_initialisation(7):
        weights = torch.randn(16)
    assert not torch.isin(weights, torch.randn(1000, generator=torch.Generator().manual_seed(7))).any()
