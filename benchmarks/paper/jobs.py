"""The training of all columns: real jobs on one small Ray cluster, each of which goes on where it was."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ray
import torch

from benchmarks.machine import ROOT
from benchmarks.paper.columns import BASE, Column, Scale
from cspace.errors import JobError
from training.models.checkpoint import read_progress
from training.trials.launch import QUIET

JOB = ROOT / "training" / "cluster_train.py"


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

    def encoder(self) -> Path | None:
        """The encoder that the columns share, once it is trained."""
        steps = self.scale.config(BASE, None).vae.steps
        return self.checkpoints(BASE, "vae").get(steps)

    def printed(self, column: Column) -> str:
        """The column's log so far."""
        path = self.log(column)
        return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def train_columns(study: Study, columns: Sequence[Column], say: Callable[[str], None] = print) -> None:
    """Train what is not trained yet, one column after the other.

    Raises:
        JobError: a column's job failed; its log is named.
    """
    waiting = [column for column in columns if study.result(column) is None]
    if not waiting:
        return
    # The study's own niceness is the user's choice; Ray would add 15.
    os.environ.setdefault("RAY_worker_niceness", "0")
    ray.init(num_cpus=study.at_once, include_dashboard=False, runtime_env={"env_vars": QUIET})
    try:
        for column in waiting:
            say(f"training: {column.label}; {study.log(column)}")
            _train(study, column)
    finally:
        ray.shutdown()


def _train(study: Study, column: Column) -> None:
    folder = study.job_folder(column)
    if folder is None:
        alone = column == BASE or study.scale.config(column, None).joint
        settings = study.scale.overrides(column, None if alone else study.encoder(), study.gpus)
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
    study.log(column).parent.mkdir(parents=True, exist_ok=True)
    with study.log(column).open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, str(JOB), *arguments],
            # MLflow puts the artifacts of a store without a server below the working folder.
            cwd=study.out,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            code = process.wait()
        finally:
            # A study that is stopped stops its job, which goes on with the next call.
            process.terminate()
            process.wait()
    if code != 0 or study.result(column) is None:
        raise JobError(
            f"the job of the column {column.name} failed",
            expected="exit code 0 and a result",
            got=f"exit code {code}",
            remedy=f"see {study.log(column)}; run the study again to go on",
        )
