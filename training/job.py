"""One training job: its configuration, its runs and its folder, so that a stopped one can go on."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import ValidationError

from cspace.errors import ConfigError
from services.registry.mlflow_tracking import MlflowTracking
from services.registry.names import EXPERIMENT
from services.registry.tracking import RunLog, Tracking
from training.config_files import Section
from training.environment import Environment

RECORD = "job.json"

Config = TypeVar("Config", bound=Section)


@dataclass(frozen=True, slots=True)
class Job(Generic[Config]):
    """A job under way.

    Args:
        config: what it trains.
        environment: where it works.
        tracking: its server.
        run: the parent run.
        folder: of its trials, named after the run; ``job.json`` there holds configuration and child runs.
        children: child run by trial.
    """

    config: Config
    environment: Environment
    tracking: Tracking
    run: RunLog
    folder: Path
    children: dict[str, str]

    @classmethod
    def start(
        cls, config: Config, environment: Environment, tags: Mapping[str, str], name: str = "cluster-train"
    ) -> "Job[Config]":
        """A new job with a run of its own, so named."""
        tracking = MlflowTracking(environment.tracking_uri)
        run = tracking.start(EXPERIMENT, name, tags=tags)
        job = cls(config, environment, tracking, run, job_folder(environment, run.run_id), {})
        job.folder.mkdir(parents=True, exist_ok=True)
        job._save()
        return job

    @classmethod
    def resume(cls, run_id: str, environment: Environment, kind: type[Config]) -> "Job[Config]":
        """A job that was stopped, with the runs that it had.

        Args:
            run_id: of the parent run.
            environment: the same as the job's.
            kind: of configuration that it had.

        Raises:
            ConfigError: no such job worked in this data folder, or one of another kind.
        """
        folder = job_folder(environment, run_id)
        try:
            record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(
                "there is no such job to go on with",
                expected=f"a run's id with {RECORD} under {folder.parent}",
                got=repr(run_id),
                remedy="take the id of the line `run: ...` at the start of the job's log",
            ) from error
        try:
            config = kind.model_validate(record["config"])
        except ValidationError as error:
            raise ConfigError(
                "the job is of another kind", expected=kind.__name__, got=str(error.errors()[0]["loc"])
            ) from error
        tracking = MlflowTracking(environment.tracking_uri)
        return cls(config, environment, tracking, tracking.resume(run_id), folder, dict(record["children"]))

    def child(self, name: str) -> str:
        """A trial's run, made here so that a retried trial and a resumed job continue it."""
        if name not in self.children:
            run = self.tracking.start(EXPERIMENT, name, parent_run_id=self.run.run_id)
            self.children[name] = run.run_id
            self._save()
        return self.children[name]

    def _save(self) -> None:
        record = {"config": self.config.to_dict(), "children": self.children}
        beside = self.folder / f"{RECORD}.tmp"
        beside.write_text(json.dumps(record, indent=2), encoding="utf-8")
        beside.replace(self.folder / RECORD)


def job_folder(environment: Environment, run_id: str) -> Path:
    """Where the job of a run keeps its trials."""
    return environment.data_folder / "jobs" / Path(run_id).name
