"""One training job: its configuration, name, labels, runs and folder, so that a stopped one resumes."""

import json
import logging
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from cspace.bundle import Bundle
from cspace.dataset import require_room
from cspace.errors import BundleError, ConfigError, JobError, StorageError
from cspace.files import HALF_SUFFIX, discard, holding, project_error, replacing
from cspace.world import World
from cspace.worlds import robot_digest
from services.commands import numbers
from services.names import (
    ALIAS_CHALLENGER,
    ALIAS_CHAMPION,
    EXPERIMENT,
    TAG_JOB,
    TAG_PRESET,
    TAG_ROBOT,
    TAG_STAGE,
    TAG_WORLD,
    model_name,
    recorded_name,
    robot_name,
)
from services.registry import connect, tracking_uri
from services.registry.entities import ID, flatten
from services.registry.errors import retry
from services.registry.models import ModelRegistry
from services.registry.tracking import RunLog, Tracking
from training.config import JobConfig

LONGEST = 100
"""Characters of a parameter."""
# In a job's folder, and an artifact of its run.
CONFIGURATION = "configuration.json"
BUNDLE_FOLDER = "bundle"
# On a trial's run: its name in the job.
TAG_TRIAL = "trial"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}")
_LOG = logging.getLogger("training")

Config = TypeVar("Config", bound=JobConfig)
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Environment:
    """Where a job works."""

    tracking_uri: str
    data_folder: Path
    patience_s: float = 600.0


def job_environment() -> Environment:
    """MLFLOW_TRACKING_URI and CSPACE_DATA_DIR, which the Ray head of ``make up`` hands to its jobs.

    CSPACE_TRACKING_PATIENCE_S, where it is set, is how long a job waits for a tracking server that is away.
    """
    folder = os.environ.get("CSPACE_DATA_DIR", "")
    remedy = "submit to the Ray head of `make up`, which sets both, or export them"
    uri = tracking_uri(remedy=remedy)
    if not Path(folder).is_absolute():
        raise ConfigError(
            "CSPACE_DATA_DIR does not fit", expected="an absolute folder", got=repr(folder), remedy=remedy
        )
    patience = os.environ.get("CSPACE_TRACKING_PATIENCE_S") or "600"
    try:
        return Environment(uri, Path(folder), float(patience))
    except ValueError as error:
        raise ConfigError(
            "CSPACE_TRACKING_PATIENCE_S does not fit", expected="seconds", got=repr(patience)
        ) from error


def job_folder(environment: Environment, run_id: str) -> Path:
    """Where the job of a run keeps its trials."""
    return environment.data_folder / "jobs" / Path(run_id).name


def job_label(config: JobConfig, name: str | None) -> str:
    """A job in a run's name: its own name, or its preset's, and its seed."""
    return f"{name or config.preset}, seed {config.seed}"


def shown_tags(config: JobConfig, name: str | None, stage: str) -> dict[str, str]:
    """Tags of a job's run, or of a trial's."""
    return {TAG_STAGE: stage, TAG_JOB: name or "", TAG_PRESET: config.preset}


def world_tag(world: World, given: str | None) -> dict[str, str]:
    """The tag of the world and the robot that a job is for."""
    return {TAG_WORLD: f"{world.kind}, {robot_name(world, given)}"}


@dataclass(frozen=True, slots=True)
class Job(Generic[Config]):
    """A job under way. Its run in MLflow has its tags and its trials, its folder all else."""

    config: Config
    environment: Environment
    tracking: Tracking
    run: RunLog
    folder: Path
    children: dict[str, str]  # runs of trials
    name: str | None = None
    extra_tags: dict[str, str] = field(default_factory=dict)

    @classmethod
    def start(
        cls,
        config: Config,
        environment: Environment,
        tags: Mapping[str, str],
        stage: str = "cluster-train",
        name: str | None = None,
    ) -> "Job[Config]":
        """A new job with a run of its own, or the one that was submitted under this name before."""
        if name is not None and not _NAME.fullmatch(name):
            raise ConfigError(
                "a job's name does not fit",
                expected="1 to 63 letters, digits, - and _, a letter or digit first",
                got=repr(name),
            )
        named = _prepared(environment) / (name or "")
        if named.is_file():
            return cls.resume(named.read_text(encoding="utf-8"), environment, type(config)).same(config)
        tracking = Tracking(environment.tracking_uri, wait_s=environment.patience_s)
        title, tags = f"{job_label(config, name)}, {ID}", {**tags, **shown_tags(config, name, stage)}
        # A driver that was killed here finds its run by the key.
        key = None if name is None else f"job/{name}"
        run_id = tracking.start(EXPERIMENT, title, None, tags, key=key).run_id
        path = job_folder(environment, run_id) / CONFIGURATION
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            _write(path, json.dumps(config.to_dict(), indent=1))
        if name is not None:
            _write(named, run_id)
        return cls.resume(run_id, environment, type(config)).same(config)

    @classmethod
    def resume(cls, run_id: str, environment: Environment, kind: type[Config]) -> "Job[Config]":
        """A job that was stopped, with the runs that it had."""
        folder = job_folder(environment, run_id)
        try:
            config = kind.from_dict(json.loads((folder / CONFIGURATION).read_bytes()))
        except OSError as error:
            raise ConfigError(
                "there is no such job to go on with",
                expected=f"a run's id with {CONFIGURATION} under {folder.parent}",
                got=repr(run_id),
                remedy="take the id of the line `run: ...` at the start of the job's log",
            ) from error
        except ValidationError as error:
            raise project_error(error, ConfigError, f"the job is no {kind.__name__}") from error
        tracking = Tracking(environment.tracking_uri, wait_s=environment.patience_s)
        run, tags = tracking.resume(run_id), tracking.run(run_id).data.tags
        trials = retry("looking at the trials", partial(tracking.children, run_id), environment.patience_s)
        tagged = ((one.data.tags.get(TAG_TRIAL), one.info.run_id) for one in trials)
        children = {trial: child for trial, child in tagged if trial is not None}
        return cls(config, environment, tracking, run, folder, children, tags.get(TAG_JOB) or None)

    @contextmanager
    def running(self) -> Iterator[RunLog]:
        """The run, while this process works on the job."""
        busy = JobError(
            "the job is running already", got=f"run {self.run.run_id}", remedy="wait for it, or stop it first"
        )
        with holding(self.folder / "lock", busy):
            _LOG.info("run: %s", self.run.run_id)
            # What processes that were killed had begun to write.
            for half in (*self.folder.rglob(f"*{HALF_SUFFIX}"), *self.folder.glob(".*")):
                discard(half)
            with self.run as run:
                yield run

    def log_configuration(self) -> None:
        """The settings as parameters, one each, and the whole of them as a file.

        Those that are longer than a column of a table are left to the file, and those that are not set.
        """
        values = flatten(self.config.to_dict())
        self.run.params(
            {key: text for key, text in values.items() if text != "None" and len(text) <= LONGEST}
        )
        self.run.artifact(self.folder / CONFIGURATION)

    def child(self, name: str) -> str:
        """A trial's run, made here so that a retried trial and a resumed job continue it."""
        if name not in self.children:
            title, parent = f"{name}, {job_label(self.config, self.name)}", self.run.run_id
            tags = shown_tags(self.config, self.name, name.partition("-")[0])
            tags |= self.extra_tags | {TAG_TRIAL: name}
            self.children[name] = self.tracking.start(EXPERIMENT, title, parent, tags).run_id
        return self.children[name]

    def add_tags(self, tags: Mapping[str, str]) -> None:
        """Tags for the run and for its children, those that are there and those to come."""
        self.extra_tags.update(tags)
        self.run.tags(tags)
        for run_id in self.children.values():
            self.tracking.note(run_id, tags=tags)

    def patiently(self, action: str, call: Callable[[], Answer]) -> Answer:
        """The answer of ``call``, asked again while the tracking server is away."""
        return retry(action, call, self.environment.patience_s)

    def register(self, model: str, bundle: Bundle, run_id: str, tags: Mapping[str, str]) -> int:
        """Make a bundle the next version of a model, by the run that trained it, and the challenger."""
        registry = ModelRegistry(self.environment.tracking_uri)
        tags = {**tags, "preset": self.config.preset, "seed": str(self.config.seed)}
        version = self.patiently(
            "registering the bundle",
            lambda: registry.register(
                model, bundle.folder, run_id, bundle.digest, tags, alias=ALIAS_CHALLENGER
            ),
        )
        _LOG.info("registry: %s version %d, alias %s", model, version.number, ALIAS_CHALLENGER)
        return version.number

    def same(self, config: Config) -> "Job[Config]":
        """This job, if it has these settings."""
        ours, given = flatten(self.config.to_dict()), flatten(config.to_dict())
        if other := [key for key in sorted(ours | given) if ours.get(key) != given.get(key)][:5]:
            raise ConfigError(
                f"the job {self.name} has other settings: {', '.join(other)}",
                expected=", ".join(f"{key}={ours.get(key)}" for key in other),
                got=", ".join(f"{key}={given.get(key)}" for key in other),
                remedy=f"take another name, or go on as it began by --resume {self.run.run_id}",
            )
        return self


def _prepared(environment: Environment) -> Path:
    """The folder of the jobs' names, where the data folder can be written and has room."""
    names = environment.data_folder / "jobs" / "names"
    try:
        names.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            "the data folder cannot be written",
            expected="a folder with room and rights",
            got=str(error),
            remedy="set CSPACE_DATA_DIR to another one",
        ) from error
    require_room(environment.data_folder, 0)
    return names


def _write(path: Path, text: str) -> None:
    with replacing(path, "the job's folder") as beside:
        beside.write_text(text, encoding="utf-8")


@dataclass(frozen=True, slots=True)
class JobResult:
    """What a job leaves behind."""

    run_id: str
    model: str
    version: int
    digest: str
    data_digest: str
    metrics: Mapping[str, float]
    trials: Mapping[str, tuple[float, float]]
    figures: tuple[str, ...]

    def rows(self, folder: Path) -> dict[str, str]:
        """The lines of a block for people; the job lies in ``folder``."""
        return {
            "model": f"{self.model}/{self.version}",
            "run": self.run_id,
            "trials": numbers({name: end - start for name, (start, end) in self.trials.items()}, " s"),
            "last metrics": numbers(self.metrics),
            "data": self.data_digest,
            "bundle": str(folder / BUNDLE_FOLDER),
        }


def kept_bundle(folder: Path) -> Bundle | None:
    """The bundle that an earlier attempt has left, whole; None otherwise, and then nothing lies there."""
    try:
        return Bundle.load(folder) if folder.is_dir() else None
    except BundleError:
        discard(folder)
        return None


def registered_name(job: Job[Config], world: World, given: str | None, *, path: bool) -> str:
    """The name under which a job registers; to be asked before the long work."""
    digest, name = robot_digest(world), model_name(world, given, path=path)
    if given is None:
        return name
    registry = ModelRegistry(job.environment.tracking_uri)
    for model in {model_name(world, given, path=kind) for kind in (False, True)}:
        versions = job.patiently(f"looking at {model}", partial(registry.versions, model))
        other = next((one for one in versions if one.tags.get(TAG_ROBOT, digest) != digest), None)
        if other is not None:
            raise ConfigError(
                "robot_name is another robot's",
                expected=f"a name whose models are of robot {digest[:8]}",
                got=f"{given}, and {other} is of robot {other.tags[TAG_ROBOT][:8]}",
                remedy="set robot_name to another name",
            )
    return name


ALIASES = (ALIAS_CHALLENGER, ALIAS_CHAMPION)


def register_untrained(bundle: Bundle, uri: str, model: str, alias: str, stage: str) -> str:
    """Make a bundle that no job made the next version of a model, by a run of its own; ``name/version``."""
    tracking, registry = connect(uri)
    provenance = bundle.spec.provenance
    tags = {TAG_STAGE: stage, **world_tag(bundle.spec.world, recorded_name(provenance.config))}
    # The same bundle is registered once, however often it is given.
    key = f"{stage}/{model}/{bundle.digest}"
    with tracking.start(EXPERIMENT, f"{model}, untrained, {ID}", tags=tags, key=key) as run:
        run.params(dict(provenance.config))
        source: Any = provenance.config["source_digest"]
        tags = {"data_digest": provenance.data_digest or "", "source_digest": source}
        version = registry.register(model, bundle.folder, run.run_id, bundle.digest, tags, alias=alias)
    return str(version)
