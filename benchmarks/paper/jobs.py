"""The training of all columns: real jobs on one small Ray cluster, each of which goes on where it was."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import ray
import torch

from benchmarks.machine import ROOT
from benchmarks.paper.columns import BASE, Column, Scale
from cspace.errors import JobError
from training.config import TrainConfig
from training.models.checkpoint import read_progress
from training.trials.launch import QUIET

JOB = ROOT / "training" / "cluster_train.py"
LOOK_EVERY_S = 5.0
SHOW_EVERY_S = 30.0


@dataclass(frozen=True, slots=True)
class Study:
    """Where a study works, and how large it is."""

    out: Path
    scale: Scale
    at_once: int = 1

    @property
    def tracking_uri(self) -> str:
        return f"sqlite:///{self.out / 'mlflow.db'}"

    @property
    def data(self) -> Path:
        return self.out / "data"

    @property
    def gpus(self) -> float:
        return 1.0 / self.at_once if torch.cuda.is_available() else 0.0

    def log(self, column: Column) -> Path:
        return self.out / "logs" / f"{column.name}.log"

    def result(self, column: Column) -> dict[str, Any] | None:
        """What the column's job printed at its end."""
        lines = [line for line in self.printed(column).splitlines() if line.startswith("RESULT ")]
        return json.loads(lines[-1].removeprefix("RESULT ")) if lines else None

    def job_folder(self, column: Column) -> Path | None:
        """Where the column's job keeps its trials, once it has begun."""
        found = re.findall(r"^run: (\w+)$", self.printed(column), re.MULTILINE)
        folder = self.data / "jobs" / found[0] if found else None
        return folder if folder is not None and (folder / "job.json").is_file() else None

    def checkpoints(self, column: Column, trial: str) -> dict[int, Path]:
        """Checkpoint by step of a trial: ``vae``, ``local-0``, ``global``."""
        folder = self.job_folder(column)
        if folder is None:
            return {}
        found = folder.glob(f"*/{trial}/step-*/state.json")
        return {read_progress(state.parent).step: state.parent for state in sorted(found)}

    def encoder(self, base: Column) -> Path | None:
        """The encoder that the columns share, once it is trained."""
        steps = self.scale.config(base, None).vae.steps
        return self.checkpoints(base, "vae").get(steps)

    def printed(self, column: Column) -> str:
        """The column's log so far."""
        path = self.log(column)
        return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


@dataclass(slots=True)
class Running:
    """A column's job under way."""

    column: Column
    process: subprocess.Popen[bytes]


@dataclass(slots=True)
class Pace:
    """Time left, by the generator steps that were done since this study was started."""

    total: int
    first: int | None = None
    began_s: float = field(default_factory=time.monotonic)

    def left_s(self, done: int) -> float | None:
        """None until it can be told."""
        if self.first is None:
            self.first, self.began_s = done, time.monotonic()
        made = done - self.first
        return None if made < 1 else (self.total - done) * (time.monotonic() - self.began_s) / made


def train_columns(study: Study, columns: Sequence[Column], say: Callable[[str], None] = print) -> None:
    """Train what is not trained yet, at most ``at_once`` columns at a time.

    Raises:
        JobError: a column's job failed; its log is named.
    """
    base = next(column for column in columns if column.name == BASE)
    waiting = [column for column in columns if study.result(column) is None]
    if not waiting:
        return
    study.log(base).parent.mkdir(parents=True, exist_ok=True)
    # The study's own niceness is the user's choice; Ray would add 15.
    os.environ.setdefault("RAY_worker_niceness", "0")
    ray.init(num_cpus=study.at_once, include_dashboard=False, runtime_env={"env_vars": QUIET})
    running: list[Running] = []
    pace, shown_s = Pace(sum(steps_of(study.scale.config(column, None)) for column in columns)), 0.0
    try:
        while waiting or running:
            for column in [c for c in waiting if _ready(study, c, base)][: study.at_once - len(running)]:
                running.append(Running(column, _start(study, column, base)))
                waiting.remove(column)
            running = [one for one in running if not _ended(study, one)]
            if time.monotonic() - shown_s >= SHOW_EVERY_S:
                shown_s = time.monotonic()
                say(_progress(study, columns, pace))
            time.sleep(LOOK_EVERY_S)
    finally:
        for one in running:
            one.process.terminate()
        for one in running:
            one.process.wait()
        ray.shutdown()


def steps_of(config: TrainConfig) -> int:
    """Generator steps of a column's trials in all."""
    return config.global_.steps + config.local_trials * config.local.steps


def _ready(study: Study, column: Column, base: Column) -> bool:
    alone = column is base or study.scale.config(column, None).joint
    return alone or study.encoder(base) is not None


def _start(study: Study, column: Column, base: Column) -> subprocess.Popen[bytes]:
    folder = study.job_folder(column)
    if folder is None:
        given = None if column is base or study.scale.config(column, None).joint else study.encoder(base)
        settings = study.scale.overrides(column, given, study.gpus)
        arguments = ["--preset", column.preset, *(part for one in settings for part in ("--set", one))]
    else:
        arguments = ["--resume", folder.name]
    environment = os.environ | {
        "RAY_ADDRESS": ray.get_runtime_context().gcs_address,
        "RAY_DEDUP_LOGS": "0",
        "MLFLOW_TRACKING_URI": study.tracking_uri,
        "CSPACE_DATA_DIR": str(study.data),
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
    }
    with study.log(column).open("ab") as log:
        return subprocess.Popen(
            [sys.executable, str(JOB), *arguments],
            # MLflow puts the artifacts of a store without a server below the working folder.
            cwd=study.out,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )


def _ended(study: Study, one: Running) -> bool:
    code = one.process.poll()
    if code is None:
        return False
    if code != 0 or study.result(one.column) is None:
        raise JobError(
            f"the job of the column {one.column.name} failed",
            expected="exit code 0 and a result",
            got=f"exit code {code}",
            remedy=f"see {study.log(one.column)}; run the study again to go on",
        )
    return True


def _progress(study: Study, columns: Sequence[Column], pace: Pace) -> str:
    done = {column.name: _steps_done(study, column) for column in columns}
    shown = ", ".join(
        f"{column.name} {done[column.name]}/{steps_of(study.scale.config(column, None))}"
        for column in columns
    )
    left = pace.left_s(sum(done.values()))
    return f"generator steps: {shown}; {'...' if left is None else f'{left / 60:.0f} min'} left"


def _steps_done(study: Study, column: Column) -> int:
    """By the log, which tells more than the checkpoints."""
    if study.result(column) is not None:
        return steps_of(study.scale.config(column, None))
    seen: dict[str, int] = {}
    for trial, step in re.findall(r"(local-\d+|global): step (\d+)/", study.printed(column)):
        seen[trial] = int(step)
    return sum(seen.values())
