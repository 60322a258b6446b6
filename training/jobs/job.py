"""One training job: its configuration, name, labels, runs and folder, so that a stopped one resumes."""

import json
import logging
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import ValidationError

from cspace.bundle import Bundle
from cspace.dataset import require_room
from cspace.errors import BundleError, ConfigError, JobError, StorageError
from cspace.files import HALF_SUFFIX, discard, holding, write_json
from cspace.strict_json import refused
from cspace.world import World
from cspace.worlds import robot_digest
from services.names import (
    EXPERIMENT,
    TAG_JOB,
    TAG_PRESET,
    TAG_ROBOT,
    TAG_STAGE,
    TAG_WORLD,
    model_name,
    robot_name,
)
from services.registry.entities import ID, flatten
from services.registry.errors import retry
from services.registry.models import ModelRegistry
from services.registry.tracking import RunLog, Tracking
from training.config import JobConfig
from training.jobs.environment import (
    RECORD,
    Environment,
    explanation,
    job_folder,
    pointer,
    run_of,
    submission_id,
)
from training.jobs.fine_tuning import earlier_job, require_folder
from training.section import Section

LONGEST = 100
"""Characters of a parameter."""


def job_label(config: JobConfig, name: str | None) -> str:
    """A job in a run's name: its own name, or its preset's, and its seed."""
    return f"{name or config.preset}, seed {config.seed}"


def shown_tags(config: JobConfig, name: str | None, stage: str) -> dict[str, str]:
    """Tags of a job's run, or of a trial's."""
    return {TAG_STAGE: stage, TAG_JOB: name or "", TAG_PRESET: config.preset}


def world_tag(world: World, given: str | None) -> dict[str, str]:
    """The tag of the world and the robot that a job is for."""
    return {TAG_WORLD: f"{world.kind}, {robot_name(world, given)}"}


def log_configuration(run: RunLog, config: JobConfig) -> None:
    """The settings as parameters, one each, and the whole of them as ``configuration.json``.

    Those that are longer than a column of a table are left to the file, and those that are not set.
    """
    values = config.to_dict()
    short = {key: text for key, text in flatten(values).items() if text != "None" and len(text) <= LONGEST}
    run.params(short)
    with tempfile.TemporaryDirectory(prefix="cspace-configuration-") as folder:
        path = Path(folder) / "configuration.json"
        path.write_text(json.dumps(values, indent=1), encoding="utf-8")
        run.artifact(path)


# On a run and a version: the run of the job whose weights it started from.
TAG_START = "start_from.run_id"
# On a trial's run: its name in the job.
TAG_TRIAL = "trial"
# Under which of Ray's ids the job runs; there while it does.
_RUNNING = "running.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}")
_LOG = logging.getLogger("training")

Config = TypeVar("Config", bound=JobConfig)
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Job(Generic[Config]):
    """A job under way."""

    config: Config
    environment: Environment
    tracking: Tracking
    run: RunLog
    folder: Path
    children: dict[str, str]
    name: str | None = None
    start_run_id: str | None = None
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
        prepare(environment)
        known = None if name is None else run_of(environment, name)
        if known is not None:
            return cls.resume(known, environment, type(config)).same(config)
        start = config.start_from and earlier_job(config, config.start_from, environment)
        tags = {**tags, "start_from": config.start_from or "", TAG_START: start} if start else tags
        tracking = Tracking(environment.tracking_uri, wait_s=environment.patience_s)
        title, tags = f"{job_label(config, name)}, {ID}", {**tags, **shown_tags(config, name, stage)}
        key = None if name is None else f"job/{name}"
        run = tracking.start(EXPERIMENT, title, None, tags, key=key)
        folder = job_folder(environment, run.run_id)
        if not (folder / RECORD).exists():
            folder.mkdir(parents=True, exist_ok=True)
            _record(folder, config, {}, name, start)
        if name is not None:
            write_json(pointer(environment, name), {"run_id": run.run_id})
        return cls.resume(run.run_id, environment, type(config)).same(config)

    @classmethod
    def resume(cls, run_id: str, environment: Environment, kind: type[Config]) -> "Job[Config]":
        """A job that was stopped, with the runs that it had."""
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
            config = kind.from_dict(record["config"])
        except ValidationError as error:
            raise refused(error, ConfigError, f"the job is no {kind.__name__}") from error
        tracking = Tracking(environment.tracking_uri, wait_s=environment.patience_s)
        children, named, start = dict(record["children"]), record.get("name"), record.get("start")
        run = tracking.resume(run_id)
        return cls(config, environment, tracking, run, folder, children, named, start)

    @contextmanager
    def running(self) -> Iterator[RunLog]:
        """The run, while this process works on the job."""
        with holding(self.folder / "lock", self._busy()):
            _LOG.info("run: %s", self.run.run_id)
            self._tidy()
            submission = submission_id()
            for line in explanation(submission):
                _LOG.info("%s", line)
            if submission is not None:
                write_json(self.folder / _RUNNING, {"submission_id": submission})
            with self.run as run:
                yield run
                self._tidy()

    def child(self, name: str) -> str:
        """A trial's run, made here so that a retried trial and a resumed job continue it."""
        if name not in self.children:
            title, parent = f"{name}, {job_label(self.config, self.name)}", self.run.run_id
            tags = (
                shown_tags(self.config, self.name, name.partition("-")[0])
                | self.extra_tags
                | {TAG_TRIAL: name}
            )
            run = self.tracking.start(EXPERIMENT, title, parent, tags, key=f"{parent}/{name}")
            self.children[name] = run.run_id
            _record(self.folder, self.config, self.children, self.name, self.start_run_id)
        return self.children[name]

    @property
    def start_folder(self) -> Path | None:
        """The folder of the job whose weights its trials start from; None where they start from nothing."""
        start = self.start_run_id
        return None if start is None else require_folder(job_folder(self.environment, start))

    def add_tags(self, tags: Mapping[str, str]) -> None:
        """Tags for the run and for its children, those that are there and those to come."""
        self.extra_tags.update(tags)
        self.run.tags(tags)
        for run_id in self.children.values():
            self.tracking.note(run_id, tags=tags)

    def patiently(self, action: str, call: Callable[[], Answer]) -> Answer:
        """The answer of ``call``, asked again while the tracking server is away."""
        return retry(action, call, self.environment.patience_s)

    def _busy(self) -> JobError:
        """That another process works on the job, with Ray's id of it where it has one."""
        got, remedy = f"run {self.run.run_id}", "wait for it, or stop it first"
        with suppress(OSError, ValueError, LookupError):
            running = json.loads((self.folder / _RUNNING).read_text(encoding="utf-8"))["submission_id"]
            got, remedy = f"{got}, submitted as {running}", f"{remedy}: ray job stop {running}"
        return JobError("the job is running already", got=got, remedy=remedy)

    def _tidy(self) -> None:
        """Delete what processes that were killed had begun to write, and what tells of one under way."""
        for half in (*self.folder.rglob(f"*{HALF_SUFFIX}"), *self.folder.glob(".*"), self.folder / _RUNNING):
            discard(half)

    def same(self, config: Config) -> "Job[Config]":
        """This job, if it has these settings."""
        ours, given = flatten(self.config.to_dict()), flatten(config.to_dict())
        changed = sorted(key for key in ours.keys() | given.keys() if ours.get(key) != given.get(key))
        if changed:
            raise ConfigError(
                f"the job {self.name} has other settings",
                expected=", ".join(f"{key}={ours.get(key)}" for key in changed[:5]),
                got=", ".join(f"{key}={given.get(key)}" for key in changed[:5]),
                remedy=f"take another name, or go on as it began by --resume {self.run.run_id}",
            )
        return self


def kept_bundle(folder: Path) -> Bundle | None:
    """The bundle that an earlier attempt has left, whole; None otherwise, and then nothing lies there."""
    try:
        return Bundle.load(folder) if folder.is_dir() else None
    except BundleError:
        discard(folder)
        return None


def prepare(environment: Environment) -> None:
    """See that the data folder can be written and has room, before the long work."""
    try:
        (environment.data_folder / "jobs" / "names").mkdir(parents=True, exist_ok=True)
        probe = environment.data_folder / "jobs" / ".probe"
        probe.write_text("", encoding="utf-8")
        probe.unlink(missing_ok=True)
    except OSError as error:
        raise StorageError(
            "the data folder cannot be written",
            expected="a folder with room and rights",
            got=str(error),
            remedy="set CSPACE_DATA_DIR to another one",
        ) from error
    require_room(environment.data_folder, 0)


def _record(
    folder: Path, config: Section, children: Mapping[str, str], name: str | None, start: str | None
) -> None:
    record = {"config": config.to_dict(), "children": dict(children), "name": name}
    write_json(folder / RECORD, record | ({"start": start} if start else {}), indent=2)


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
