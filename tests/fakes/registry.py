"""Tracking and registry in memory. They pass the same contract tests as those on MLflow."""

import json
import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mlflow.entities import Metric, Run, RunData, RunInfo, RunTag

from cspace.bundle import BundleSpec
from cspace.bundle.files import SPEC_FILE, read_files
from cspace.errors import (
    BundleIntegrityError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
    StorageError,
)
from services.names import TAG_DIGEST, TAG_KEY, TAG_PARENT, world_tags
from services.registry.entities import ID, ID_LENGTH, ModelVersion, RunStatus, flatten
from services.registry.models import ModelRegistry
from services.registry.tracking import RunLog, Tracking


@dataclass
class FakeRun:
    """What a run holds."""

    run_id: str
    experiment: str
    name: str
    parent_run_id: str | None
    status: str = "RUNNING"
    params: dict[str, str] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    history: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    artifacts: dict[str, bytes] = field(default_factory=dict)
    inputs: list[dict[str, str]] = field(default_factory=list)


class FakeRunLog(RunLog):
    """A RunLog that writes straight into a FakeRun."""

    def __init__(self, run: FakeRun) -> None:
        self._run, self.run_id = run, run.run_id

    def params(self, params: Mapping[str, Any]) -> None:
        for name, value in flatten(params).items():
            if self._run.params.setdefault(name, value) != value:
                raise RegistryError(f"the parameter {name} has a value already")

    def history(self, rows: Iterable[Mapping[str, float]]) -> None:
        for row in rows:
            for name, value in row.items():
                point = (int(row["step"]), float(value))
                if name not in ("step", "time_ms"):
                    points = self._run.history.setdefault(name, [])
                    points += [point] if point not in points else []

    def tags(self, tags: Mapping[str, str]) -> None:
        self._run.tags |= tags

    def artifact(self, path: Path, folder: str = "") -> None:
        if not path.exists():
            raise RegistryError("there is no such artifact", got=str(path))
        files = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]
        root = path.parent if path.is_file() else path
        for one in files:
            self._run.artifacts[(Path(folder) / one.relative_to(root)).as_posix()] = one.read_bytes()

    def figure(self, fig: Any, name: str) -> None:
        # The pixels are nobody's business in a unit test, and rendering is slow.
        self._run.artifacts[f"figures/{name.removesuffix('.png')}.png"] = b"\x89PNG"

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        rows = [list(row) for row in zip(*columns.values(), strict=True)]
        text = json.dumps({"columns": list(columns), "data": rows})
        self._run.artifacts.setdefault(f"tables/{name}.json", text.encode())

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        entry = {"name": name, "digest": digest, "source": source, "context": context}
        if entry not in self._run.inputs:
            self._run.inputs.append(entry)

    def finish(self, status: RunStatus = "FINISHED") -> None:
        self._run.status = status


class FakeTracking(Tracking):
    """Tracking in memory; ``runs`` is what it was told."""

    def __init__(self) -> None:
        self.runs: dict[str, FakeRun] = {}

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
        key: str | None = None,
    ) -> RunLog:
        if key is not None:
            for run in self.runs.values():
                if (run.experiment, run.tags.get(TAG_KEY)) == (experiment, key):
                    return self.resume(run.run_id)
            tags = {**(tags or {}), TAG_KEY: key}
        run_id = f"{len(self.runs) + 1:032x}"
        name = name.replace(ID, run_id[:ID_LENGTH])
        self.runs[run_id] = FakeRun(run_id, experiment, name, parent_run_id, tags=dict(tags or {}))
        return FakeRunLog(self.runs[run_id])

    def note(self, run_id: str, tags: Mapping[str, str]) -> None:
        if run_id not in self.runs:
            raise RegistryError(f"there is no run {run_id}")
        self.runs[run_id].tags |= tags

    def resume(self, run_id: str) -> RunLog:
        if run_id not in self.runs:
            raise RegistryError(f"there is no run {run_id}")
        run = self.runs[run_id]
        run.status = "RUNNING"
        return FakeRunLog(run)

    def run(self, run_id: str) -> Run:
        if run_id not in self.runs:
            raise RegistryError(f"there is no run {run_id}")
        run = self.runs[run_id]
        metrics = [Metric(name, *points[-1][::-1], 0) for name, points in run.history.items()]
        tags = run.tags | ({TAG_PARENT: run.parent_run_id} if run.parent_run_id else {})
        info = RunInfo(run_id, run.experiment, "", run.status, 0, 0, "active", run_name=run.name)
        return Run(info, RunData(metrics, tags=[RunTag(*pair) for pair in tags.items()]))

    def children(self, run_id: str) -> list[Run]:
        runs = reversed(self.runs.values())
        return [self.run(run.run_id) for run in runs if run.parent_run_id == run_id]

    def finished(self, experiment: str) -> list[Run]:
        runs = reversed(self.runs.values())
        ended = [run for run in runs if (run.experiment, run.status) == (experiment, "FINISHED")]
        return [self.run(run.run_id) for run in ended]

    def file(self, run_id: str, path: str, folder: Path) -> Path | None:
        kept = self.runs[run_id].artifacts.get(path)
        if kept is None:
            return None
        fetched = folder / path
        fetched.parent.mkdir(parents=True, exist_ok=True)
        fetched.write_bytes(kept)
        return fetched

    def remove_file(self, run_id: str, path: str) -> None:
        self.runs[run_id].artifacts.pop(path, None)


class FakeRegistry(ModelRegistry):
    """A model registry in memory that keeps its bundles in a folder.

    Args:
        folder: for the bundles.
        runs: of a FakeTracking, against which run ids are checked; None takes any.

    ``away`` makes every call raise RegistryUnavailableError, as a stopped server does.
    """

    def __init__(self, folder: Path, runs: Mapping[str, FakeRun] | None = None) -> None:
        self.away = False
        self._folder = folder
        self._runs = runs
        self._versions: dict[str, list[ModelVersion | None]] = {}
        self._aliases: dict[tuple[str, str], int] = {}
        self.shown: dict[tuple[str, int], tuple[Mapping[str, float], str]] = {}

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
        files = read_files(bundle_folder)
        got = files.digest
        if got != digest:
            raise BundleIntegrityError("another bundle", expected=digest, got=got)
        world = BundleSpec.from_json(files.contents[SPEC_FILE]).world
        tags = {**tags, **world_tags(world), TAG_DIGEST: digest}
        self._check_there()
        if self._runs is not None and run_id not in self._runs:
            raise RegistryError(f"there is no run {run_id}")
        known = self._versions.setdefault(name, [])
        same = [one.number for one in known if one and (one.run_id, one.digest) == (run_id, digest)]
        number = same[0] if same else len(known) + 1
        if not same:
            known.append(ModelVersion(name, number, run_id, digest, (), {}, time.time_ns() // 1_000_000))
            shutil.copytree(bundle_folder, self._place(name, number))
        self.set_tags(name, number, tags)
        if alias is not None:
            self.set_alias(name, alias, number)
        return self.version(name, number)

    def version(self, name: str, number: int) -> ModelVersion:
        self._check_there()
        known = dict(enumerate(self._versions.get(name, []), 1)).get(number)
        if known is None:
            raise ModelNotFoundError(f"there is no {name}/{number}")
        aliases = sorted(
            alias for (owner, alias), at in self._aliases.items() if (owner, at) == (name, number)
        )
        return replace(known, aliases=tuple(aliases))

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        self._check_there()
        if (name, alias) not in self._aliases:
            raise ModelNotFoundError(f"there is no {name}@{alias}")
        return self.version(name, self._aliases[name, alias])

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        self._check_there()
        there = [one.number for one in self._versions.get(name, []) if one]
        return tuple(self.version(name, number) for number in reversed(there))

    def names(self) -> tuple[str, ...]:
        self._check_there()
        return tuple(sorted(self._versions))

    def delete(self, name: str, number: int) -> None:
        version = self.version(name, number)
        self._versions[name][number - 1] = None
        self._aliases = {key: at for key, at in self._aliases.items() if (key[0], at) != (name, number)}
        shutil.rmtree(self._place(name, version.number), ignore_errors=True)

    def set_alias(self, name: str, alias: str, number: int) -> None:
        self.version(name, number)
        self._aliases[name, alias] = number

    def set_tags(self, name: str, number: int, tags: Mapping[str, str]) -> None:
        version = self.version(name, number)
        self._versions[name][number - 1] = replace(version, aliases=(), tags={**version.tags, **tags})

    def show(
        self, version: ModelVersion, metrics: Mapping[str, float], note: str, data: str, data_digest: str
    ) -> None:
        known = self.version(version.name, version.number)
        self.shown[known.name, known.number] = (metrics, note)
        if self._runs is not None:
            for name, value in metrics.items():
                self._runs[version.run_id].history.setdefault(name, []).append((0, value))

    def remove_tag(self, name: str, number: int, tag: str) -> None:
        version = self.version(name, number)
        kept = {key: value for key, value in version.tags.items() if key != tag}
        self._versions[name][number - 1] = replace(version, aliases=(), tags=kept)

    def download(self, version: ModelVersion, folder: Path) -> Path:
        if folder.exists():
            raise StorageError("the download's folder exists", got=str(folder))
        self.version(version.name, version.number)
        shutil.copytree(self._place(version.name, version.number), folder)
        return folder

    def _place(self, name: str, number: int) -> Path:
        return self._folder / name / str(number)

    def _check_there(self) -> None:
        if self.away:
            raise RegistryUnavailableError("the registry does not answer")
