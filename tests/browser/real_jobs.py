"""Real jobs of two presets and two seeds each, their versions judged, on an MLflow server."""

import json
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from tests.own_ray import ROOT, run_alone

PRESETS, SEEDS = ("smoke", "quickstart"), (0, 1)
# What makes seconds of minutes, whatever the preset.
SHORT = (
    *("data.scenario_count=24", "data.free_per_scenario=64", "data.collision_per_scenario=32"),
    *("data.extra_image_count=24", "vae.steps=6", "vae.width=4", "validity.steps=6", "local.steps=8"),
    *("resources.log_every_steps=2", "resources.checkpoint_every_steps=4"),
)


@dataclass(frozen=True)
class RealJob:
    """A job that ran, and the evaluation of its version.

    Args:
        preset: of its configuration.
        seed: likewise.
        run_id: its run's.
        version: ``name/number``.
        evaluation: the evaluation's run.
    """

    preset: str
    seed: int
    run_id: str
    version: str
    evaluation: str


def run_jobs(uri: str, folder: Path) -> list[RealJob]:
    """Train and judge one after the other: every preset with every seed."""
    return [_job(uri, folder, preset, seed) for preset, seed in product(PRESETS, SEEDS)]


def _job(uri: str, folder: Path, preset: str, seed: int) -> RealJob:
    sets = [part for value in (*SHORT, f"seed={seed}") for part in ("--set", value)]
    train = _run(uri, folder, str(ROOT / "training" / "cluster_train.py"), "--preset", preset, *sets)
    version = f"{train['model']}/{train['version']}"
    # Six scenes on two processes; nothing is learned in so few steps.
    judge = _run(uri, folder, "-m", "services.evaluator", "--model", version, "--scenarios", "6")
    return RealJob(preset, seed, train["run_id"], version, judge["run_id"])


def _run(uri: str, folder: Path, *command: str) -> dict[str, str]:
    done = run_alone(uri, folder, *command)
    if done.returncode != 0:
        raise RuntimeError(done.stdout + done.stderr)
    found: dict[str, str] = json.loads(done.stdout.rpartition("RESULT ")[2].splitlines()[0])
    return found
