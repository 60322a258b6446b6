"""The ports to MLflow: versions of models and their references, and tracked runs.

They import nothing of MLflow. Every method of a port raises RegistryUnavailableError when the server does not
answer, and RegistryError for what it refuses.
"""

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

from pydantic import ConfigDict, Field

from cspace.errors import ConfigError, InputError, RegistryError
from services.names import ALIAS_CHAMPION

# More than any description has. These hold where a version is read from a file or comes from another process.
_Text = Annotated[str, Field(max_length=20_000)]
_Count = Annotated[int, Field(ge=0, lt=2**53)]


@dataclass(frozen=True)
class ModelVersion:
    """One version of a registered model.

    Args:
        name: of the registered model.
        number: counts from 1 within the model.
        run_id: the run that made it.
        digest: SHA-256 of the bundle's ``SHA256SUMS``; empty for a version that somebody else registered.
        aliases: in alphabetical order.
        tags: all of them, the digest included.
        created_ms: milliseconds since 1970-01-01 UTC.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True, revalidate_instances="always")

    name: _Text
    number: _Count
    run_id: _Text
    digest: _Text
    aliases: tuple[_Text, ...]
    tags: Mapping[_Text, _Text]
    created_ms: _Count

    def __str__(self) -> str:
        return f"{self.name}/{self.number}"


@dataclass(frozen=True, slots=True)
class Shown:
    """What people see of a version once it is evaluated.

    Args:
        metrics: a few, by name.
        note: of its page, in Markdown.
        data: what it was evaluated on, in words.
        data_digest: of that, in hexadecimal.
    """

    metrics: Mapping[str, float]
    note: str
    data: str
    data_digest: str


class ModelReader(Protocol):
    """What serving asks a registry."""

    def version(self, name: str, number: int) -> ModelVersion:
        """One version by its number; raises ModelNotFoundError where there is none."""
        ...

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        """The version that an alias points to; raises ModelNotFoundError without the model or the alias."""
        ...

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """All versions, newest first; empty for an unknown model."""
        ...

    def names(self) -> tuple[str, ...]:
        """The registered models, in alphabetical order."""
        ...

    def download(self, version: ModelVersion, folder: Path) -> Path:
        """Fetch a version's bundle into a new folder, which appears whole or not at all; returns the folder.

        Raises:
            ModelNotFoundError: there is no such version, or it holds no bundle.
            StorageError: the folder exists or cannot be written.
        """
        ...


class ModelRegistry(ModelReader, Protocol):
    """Where bundles become versions. What names a version that is not there raises ModelNotFoundError."""

    def register(
        self,
        name: str,
        bundle_folder: Path,
        run_id: str,
        digest: str,
        tags: Mapping[str, str],
        *,
        alias: str | None = None,
    ) -> ModelVersion:
        """Make a bundle the next version of a model, which is created when it is new.

        The same digest from the same run is registered once: a second call returns the first version, with
        the tags and the alias set again.

        Args:
            name: of the model.
            bundle_folder: as ``cspace.bundle.write_bundle`` leaves it.
            run_id: the run that made the bundle.
            digest: what the caller takes the bundle's digest to be.
            tags: lineage, such as the data digest; :func:`services.names.world_tags` are added.
            alias: moved to this version.

        Raises:
            BundleIntegrityError: the folder is damaged or has another digest.
            RegistryError: there is no such run.
        """
        ...

    def record(
        self, name: str, run_id: str, tags: Mapping[str, str], *, alias: str | None = None
    ) -> ModelVersion:
        """Make what a run found the next version of a model without a bundle: its tags are all there is.

        A run makes one version: a second call returns it, with the tags and the alias set again.

        Args:
            name: of the model, which is created when it is new.
            run_id: the run.
            tags: of the version.
            alias: moved to this version.

        Raises:
            RegistryError: there is no such run.
        """
        ...

    def delete(self, name: str, number: int) -> None:
        """Delete a version for good; its number is not given again."""
        ...

    def set_alias(self, name: str, alias: str, number: int) -> None:
        """Point an alias to a version, away from whichever had it."""
        ...

    def remove_alias(self, name: str, alias: str) -> None:
        """Take an alias away from whichever version has it; nothing happens where none has."""
        ...

    def set_tags(self, name: str, number: int, tags: Mapping[str, str]) -> None:
        """Set tags on a version; others stay."""
        ...

    def remove_tag(self, name: str, number: int, tag: str) -> None:
        """Take a tag off a version; nothing happens where it has none of this name."""
        ...

    def describe(self, name: str, note: str) -> None:
        """Show a note in Markdown on a model's page, in place of the earlier one."""
        ...

    def show(self, version: ModelVersion, shown: Shown) -> None:
        """Show figures and a note of a version, on its run and logged model too, in place of earlier ones."""
        ...


PRETRAINED = "pretrained"
# Of other robots than the default one, and the folders of all beside the API's code.
SHIPPED = {PRETRAINED: "pretrained", f"{PRETRAINED}-panda": "pretrained_panda"}

# Names become folders of the cache: no separators, no leading dot.
_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
_PATTERN = re.compile(
    rf"(?P<name>{_NAME})"
    r"(?:@(?P<alias>[A-Za-z0-9_-]{1,100})|/(?P<version>[1-9][0-9]{0,8}))?",
    re.ASCII,
)


def is_shipped(name: str) -> bool:
    """Whether a name is one of those that the server's own models have."""
    return name in SHIPPED


def is_model_name(text: str) -> bool:
    """Whether a text can be a model's name, and so a folder's of the cache."""
    return re.fullmatch(_NAME, text, re.ASCII) is not None


@dataclass(frozen=True, slots=True)
class ModelReference:
    """A model as users name it: ``name``, ``name@alias``, ``name/version`` or ``pretrained``.

    Args:
        name: of the registered model, or ``pretrained``.
        alias: None when none was given.
        version: None when none was given.
    """

    name: str
    alias: str | None = None
    version: int | None = None

    @classmethod
    def parse(cls, text: str) -> "ModelReference":
        """Read a reference.

        Raises:
            InputError: it follows none of the forms.
        """
        match = _PATTERN.fullmatch(text)
        if match is None:
            raise InputError(
                "model is not a reference",
                expected="name, name@alias, name/version or pretrained",
                got=repr(text)[:200],
            )
        version = match["version"]
        return cls(match["name"], match["alias"], None if version is None else int(version))

    @classmethod
    def parse_version(
        cls, text: str, what: str, expected: str = "name@alias or name/version"
    ) -> "ModelReference":
        """Read a reference that names an alias or a version.

        Args:
            text: to read.
            what: is wrong where it does not, for the message.
            expected: likewise.

        Raises:
            ConfigError: it does not.
        """
        with suppress(InputError):
            found = cls.parse(text)
            if not found.is_bare:
                return found
        raise ConfigError(what, expected=expected, got=repr(text))

    def look_up(self, registry: ModelReader) -> ModelVersion:
        """The version that is meant; raises ModelNotFoundError where there is none."""
        if self.version is not None:
            return registry.version(self.name, self.version)
        return registry.by_alias(self.name, self.alias or ALIAS_CHAMPION)

    @property
    def is_bare(self) -> bool:
        """Whether neither alias nor version was given; the champion is meant."""
        return self.alias is None and self.version is None

    def __str__(self) -> str:
        if self.version is not None:
            return f"{self.name}/{self.version}"
        return self.name if self.alias is None else f"{self.name}@{self.alias}"


RunStatus = Literal["FINISHED", "FAILED", "KILLED"]
ID, ID_LENGTH = "{id}", 6
"""In a run's name, and how much of the run's id stands there instead."""


class RunLog(ABC):
    """One run that is being written. Not for sharing between threads.

    As a context manager it finishes the run, FAILED when an exception ends the block (KILLED when the
    exception is an interrupt). Metrics that could not be sent are kept and sent with the next ones.
    """

    run_id: str
    """Survives in a checkpoint; :meth:`Tracking.resume` goes on with it."""

    @abstractmethod
    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters; nested mappings become dotted names. A parameter keeps its first value for good."""

    @abstractmethod
    def metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Log metrics of one step. They are buffered, and sent by number, by age, and at the end."""

    @abstractmethod
    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags; the last value holds."""

    @abstractmethod
    def artifact(self, path: Path, folder: str = "") -> None:
        """Keep a copy of a file, or of a folder's content, in a folder of the run."""

    @abstractmethod
    def figure(self, fig: Any, name: str) -> None:
        """Keep a figure as ``figures/<name>.png``, and where the UI sets runs' pictures beside each other.

        It is one of matplotlib, and stays open.
        """

    @abstractmethod
    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Keep a table as ``tables/<name>.json``, which the UI compares between runs, and as Parquet.

        Args:
            columns: by name, all of one length: numbers, texts or None.
            name: of the table.
        """

    @abstractmethod
    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input of the run.

        Args:
            name: of the data set.
            digest: SHA-256 in hexadecimal.
            source: where it lies: a folder or an address.
            context: what it is used for: ``training``, ``evaluation``.
        """

    @abstractmethod
    def flush(self) -> None:
        """Send the metrics that wait."""

    @abstractmethod
    def finish(self, status: RunStatus = "FINISHED") -> None:
        """Send what waits and end the run."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
            return
        # The error that ended the block matters more than a server that is away or refuses as well.
        with suppress(RegistryError):
            self.finish("FAILED" if issubclass(kind, Exception) else "KILLED")


@dataclass(frozen=True, slots=True)
class FoundRun:
    """A run as it is found again.

    Args:
        run_id: its id.
        name: its name.
        parent_run_id: the run under which it is shown; None for one of its own.
        tags: all of them.
        metrics: the last value of each.
        started_ms: milliseconds since 1970-01-01 UTC.
    """

    run_id: str
    name: str
    parent_run_id: str | None
    tags: Mapping[str, str]
    metrics: Mapping[str, float]
    started_ms: int


class Tracking(Protocol):
    """Where runs are kept. Runs are named by their ids; no run is ever current."""

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
        key: str | None = None,
    ) -> RunLog:
        """Start a run, or go on with the one of the same key.

        Args:
            experiment: created when it is new.
            name: of the run; :data:`ID` in it becomes the first :data:`ID_LENGTH` characters of the run's id.
            parent_run_id: the run under which it is shown.
            tags: commit, seeds, preset.
            key: names the run within its experiment for whoever was interrupted before he could remember its
                id: letters, digits, ``-``, ``_`` and ``/``. None always starts a new one.
        """
        ...

    def resume(self, run_id: str) -> RunLog:
        """Go on with a run that was started before, by this or by another process.

        A job that goes on from a checkpoint repeats the steps after it, and a tracking server can not take
        back what it has. So metrics of a step that the run holds already are dropped.
        """
        ...

    def note(self, run_id: str, tags: Mapping[str, str]) -> None:
        """Set tags of a run, whether it has ended or not; it is not resumed."""
        ...

    def deliver(self) -> None:
        """Send what had to wait for the server, of all runs. Without a place to wait in there is nothing."""
        ...

    def run(self, run_id: str) -> FoundRun:
        """One run."""
        ...

    def children(self, run_id: str) -> tuple[FoundRun, ...]:
        """The runs that are shown under another, newest first."""
        ...

    def finished(self, experiment: str) -> tuple[FoundRun, ...]:
        """The runs of an experiment that have finished, newest first; empty for an unknown one."""
        ...

    def file(self, run_id: str, path: str, folder: Path) -> Path | None:
        """A file that a run keeps, fetched into a folder; None where it keeps none of this name."""
        ...

    def remove_file(self, run_id: str, path: str) -> None:
        """Delete a file that a run keeps, for good; nothing happens where it keeps none of this name."""
        ...


# MLflow's limits of a parameter's name and value.
MAX_NAME, MAX_VALUE = 250, 6000
_FORBIDDEN = re.compile(r"[^\w\-. /:]")


def flatten(params: Mapping[str, Any]) -> dict[str, str]:
    """Nested mappings as dotted names and text: ``{"critic": {"steps": 5}}`` is ``{"critic.steps": "5"}``.

    Sequences are written as JSON. A value longer than MLflow keeps is cut, and ends in dots.
    """
    return {_FORBIDDEN.sub("_", name)[:MAX_NAME]: _text(value) for name, value in _leaves("", params)}


def _leaves(prefix: str, params: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in params.items():
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping) and value:
            yield from _leaves(name, value)
        else:
            yield name, value


def _text(value: Any) -> str:
    text = json.dumps(value, default=str) if isinstance(value, list | tuple | Mapping) else str(value)
    return text if len(text) <= MAX_VALUE else text[: MAX_VALUE - 3] + "..."
