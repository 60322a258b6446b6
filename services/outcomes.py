"""Outcomes of answers, as users report them: a bounded folder of files, and their upload to MLflow.

A server gathers outcomes in memory and writes them as whole files, one JSON object per line
(:class:`Spool`). ``python -m services.outcomes`` uploads the files as data sets and deletes them. A batch is
moved into a folder of its own first, and stays there until it is uploaded. After an interruption the same
batch is therefore uploaded again, into the same run.

Plans that were asked to be kept are rows with their pictures. They become a file of their own, which the
command deletes when its time is over.
"""

import argparse
import base64
import hashlib
import json
import logging
import os
import secrets
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ConfigError, CspaceError, InputError, StorageBusyError, StorageError
from cspace.files import HALF_PREFIX, HALF_SUFFIX, discard, holding, replacing
from cspace.planning.paths import length_rad, spread_points
from cspace.space import JointSpace
from services.command_errors import report_error
from services.names import (
    OUTCOMES_EXPERIMENT,
    OUTCOMES_FILE,
    TAG_KEEP_UNTIL,
    TAG_STAGE,
    VIEW,
    VIEWS_FILE,
)
from services.registry.ports import Tracking

FOLDER = "CSPACE_OUTCOMES"
"""The setting that names the folder."""
# Written; refused because too many wait for the disk; refused by the disk; deleted to make room for others.
Result = Literal["kept", "busy", "storage", "space"]
RESULTS: tuple[Result, ...] = get_args(Result)

STAGE = "outcomes"
# Of one file, and of one upload, which are in memory as a whole.
MAX_FILE_BYTES, MAX_BATCH_BYTES = 16 * 2**20, 32 * 2**20
# What a small file takes of a disk.
_BLOCK_BYTES = 4096
# After which a half-written file is that of a killed process.
_WRITTEN_S = 3600.0
_SHOWN_MODELS = 20
# One picture in so many is held out. A path's points are so far apart, and each so many of them is a row.
HELD_OUT, _FINE_RAD, _EVERY = 5, 0.02, 5
_BATCH, _LOCK = "uploading", ".upload.lock"
_LOG = logging.getLogger(__name__)


class Spool:
    """Keeps outcomes in a folder that several processes may share; threads may share one, too.

    Outcomes that the disk refuses are dropped and counted. No error is raised for them.

    Args:
        folder: made with the first outcome.
        max_bytes: of all files. To stay below, the oldest are deleted. Each process beside the first may
            exceed it by a sixteenth.
        count: called with a result and the number of outcomes.
    """

    def __init__(self, folder: Path, max_bytes: int, count: Callable[[Result, int], None]) -> None:
        self._folder, self._max_bytes, self._count = folder, max_bytes, count
        self._step_bytes = min(MAX_FILE_BYTES, max_bytes // 16)
        self._waiting = bytearray()
        # What may be written before this looks at the folder again.
        self._room = 0
        # The first is held for moments, the second while the disk is busy.
        self._lock, self._disk = Lock(), Lock()

    def add(self, rows: Sequence[Mapping[str, Any]]) -> bool:
        """Takes all of these outcomes for the next :meth:`flush`, or none; returns whether it does."""
        lines = b"".join(json.dumps(row).encode() + b"\n" for row in rows)
        with self._lock:
            fits = len(self._waiting) + len(lines) <= self._step_bytes
            if fits:
                self._waiting += lines
        if not fits:
            self._count("busy", len(rows))
        return fits

    def flush(self) -> None:
        """Writes what waits as one file, whole or not at all."""
        with self._disk:
            with self._lock:
                data, self._waiting = self._waiting, bytearray()
            if not data:
                return
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._make_room(len(data) + _BLOCK_BYTES)
                name = f"{time.time_ns():020d}-{secrets.token_hex(4)}.jsonl"
                with replacing(self._folder / name) as beside:
                    beside.write_bytes(data)
            except OSError as error:
                _LOG.warning("outcomes are dropped: %s", error.strerror or type(error).__name__)
                self._count("storage", data.count(b"\n"))
            else:
                self._count("kept", data.count(b"\n"))

    def _make_room(self, size: int) -> None:
        if self._room < size:
            sizes: dict[Path, int] = {}
            # Another process, or an upload, may take a file away at any time.
            for path in files_of(self._folder):
                with suppress(FileNotFoundError):
                    sizes[path] = path.stat().st_size + _BLOCK_BYTES
            total, self._room = sum(sizes.values()), max(size, self._step_bytes)
            for path, held in sizes.items():
                if total + self._room <= self._max_bytes:
                    break
                total -= held
                with suppress(FileNotFoundError):
                    lost = path.read_bytes().count(b"\n")
                    path.unlink()
                    self._count("space", lost)
            for path in self._folder.glob(f"{HALF_PREFIX}*"):
                with suppress(FileNotFoundError):
                    if time.time() - path.stat().st_mtime > _WRITTEN_S:
                        discard(path)
        self._room -= size


def files_of(folder: Path) -> list[Path]:
    """The files of outcomes, the oldest first."""
    return sorted(folder.glob("[0-9]*.jsonl"))


@dataclass(frozen=True, slots=True)
class Upload:
    """One batch that the tracking server holds.

    Args:
        run_id: of its run.
        digest: SHA-256 of its file.
        counts: number of its outcomes by kind.
    """

    run_id: str
    digest: str
    counts: Mapping[str, int]


def upload(folder: Path, tracking: Tracking) -> Iterator[Upload]:
    """Uploads the files of a folder in batches, and deletes each batch after it was uploaded.

    Args:
        folder: of the spool.
        tracking: where each batch becomes a data set.

    Raises:
        StorageError: the folder cannot be changed, or another process uploads it.
        InputError: a file does not hold outcomes.
        RegistryError: the tracking server is away or refuses.
    """
    busy = StorageBusyError("another process uploads these outcomes", remedy="wait until it is done")
    done = folder / f"{HALF_PREFIX}{_BATCH}{HALF_SUFFIX}"
    try:
        with holding(folder / _LOCK, busy):
            while files := _claim(folder):
                yield _upload(files, tracking)
                # By a rename, for a part of the batch would be another data set.
                discard(done)
                (folder / _BATCH).rename(done)
                discard(done)
    except OSError as error:
        raise StorageError(
            "the outcomes cannot be moved or copied",
            expected="room and rights in their folder and for temporary files",
            got=error.strerror or type(error).__name__,
        ) from error


def uploaded(tracking: Tracking) -> Iterator[tuple[str, str, list[dict[str, Any]]]]:
    """All batches that the tracking server holds, the oldest first: run id, SHA-256, and the outcomes.

    Raises:
        RegistryError: the tracking server is away or refuses.
    """
    for run_id, data in _files(tracking, OUTCOMES_FILE):
        yield run_id, hashlib.sha256(data).hexdigest(), [*map(json.loads, data.splitlines())]


def _files(tracking: Tracking, name: str) -> Iterator[tuple[str, bytes]]:
    with tempfile.TemporaryDirectory(prefix="cspace-outcomes-") as scratch:
        for run in reversed(tracking.finished(OUTCOMES_EXPERIMENT)):
            path = tracking.file(run.run_id, name, Path(scratch) / run.run_id)
            yield run.run_id, b"" if path is None else path.read_bytes()


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlan:
    """A plan of which pictures were kept and the end is known.

    Args:
        image: what showed the scene, as it was sent.
        path: (k, d) rad.
        collided_at: where it collides first, as a share of its length; None where it is free.
        run_id: of the batch that holds the pictures.
    """

    image: bytes
    path: NDArray[np.float64]
    collided_at: float | None
    run_id: str

    @property
    def picture(self) -> str:
        """SHA-256 of the image."""
        return hashlib.sha256(self.image).hexdigest()

    @property
    def held_out(self) -> bool:
        """Whether it is for evaluations: a fifth of all pictures, which nothing is trained on."""
        return int(self.picture, 16) % HELD_OUT == 0

    def labelled(self, space: JointSpace) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Configurations of the path that are known to be free, and to collide, each (n, d) rad.

        What comes after a collision is not known, nor for certain the tenth of a radian before it.
        """
        count = max(2, int(np.ceil(length_rad(self.path, space) / _FINE_RAD)) + 1)
        rows = space.to_float32(spread_points(self.path, count, space))
        if self.collided_at is None:
            return rows[::_EVERY], rows[:0]
        hit = round(self.collided_at * (count - 1))
        return rows[: max(0, hit - _EVERY) : _EVERY], rows[hit : hit + 1]


def known_plans(tracking: Tracking, robot: str, site: str | None = None) -> Iterator[KnownPlan]:
    """All plans of a robot of which pictures were kept and the end was reported, the oldest batch first.

    Args:
        tracking: where outcomes were uploaded.
        robot: SHA-256, as answers name it.
        site: those of one place; None for all.

    Raises:
        RegistryError: the tracking server is away or refuses.
    """
    ends: dict[tuple[Any, Any], float | None] = {}
    for _, _, rows in uploaded(tracking):
        for row in rows:
            if row["kind"] != "plan" or site not in (None, row.get("site")):
                continue
            key = row.get("client"), row["request_id"]
            collided, at = row.get("collided"), row.get("collided_at")
            # Who reports a success without more has seen no collision.
            if collided is False or (collided is None and row["success"]):
                ends[key] = None
            elif at is not None:
                ends[key] = float(at)
            else:
                ends.pop(key, None)
    for run_id, data in _files(tracking, VIEWS_FILE):
        for row in map(json.loads, data.splitlines()):
            key = row.get("client"), row["request_id"]
            if key in ends and row["robot"] == robot:
                path = np.array(row["path"], dtype=np.float64)
                yield KnownPlan(base64.b64decode(row["image"]), path, ends.pop(key), run_id)


def view_row(
    model: object, robot: str, image: bytes, path: NDArray[np.float64], keep_s: float
) -> dict[str, Any]:
    """What is kept of a plan beside its request, for so many seconds from now."""
    return {
        "kind": VIEW,
        "model": str(model),
        "robot": robot,
        "path": path.tolist(),
        "image": base64.b64encode(image).decode(),
        "keep_until_s": round(time.time() + keep_s, 3),
    }


def forget(tracking: Tracking) -> int:
    """Deletes the kept pictures whose time is over; returns of how many batches.

    Raises:
        RegistryError: the tracking server is away or refuses.
    """
    count = 0
    for run in tracking.finished(OUTCOMES_EXPERIMENT):
        until = run.tags.get(TAG_KEEP_UNTIL)
        if until and float(until) <= time.time():
            tracking.remove_file(run.run_id, VIEWS_FILE)
            tracking.note(run.run_id, {TAG_KEEP_UNTIL: ""})
            count += 1
    return count


def _claim(folder: Path) -> list[Path]:
    """The files of the next batch in the batch's folder; those of an interrupted one if there are any."""
    batch = folder / _BATCH
    batch.mkdir(exist_ok=True)
    claimed, size = files_of(batch), 0
    for path in () if claimed else files_of(folder):
        # The server may have deleted it to make room.
        with suppress(FileNotFoundError):
            size += path.stat().st_size
            if claimed and size > MAX_BATCH_BYTES:
                break
            claimed.append(path.rename(batch / path.name))
    return claimed


def _upload(files: Sequence[Path], tracking: Tracking) -> Upload:
    # Without those that a client sent twice.
    lines: dict[tuple[str, str, str], bytes] = {}
    models = set[str]()
    for path in files:
        for line in path.read_bytes().splitlines(keepends=True):
            row = _row(path, line)
            lines.setdefault((str(row.get("client")), str(row["request_id"]), str(row["kind"])), line)
            models.add(str(row["model"]))
    data = b"".join(line for (*_, kind), line in lines.items() if kind != VIEW)
    digest, counts = hashlib.sha256(data).hexdigest(), Counter(kind for *_, kind in lines)
    everything, tags = hashlib.sha256(), {TAG_STAGE: STAGE}
    for line in lines.values():
        everything.update(line)
    key = f"outcomes/{everything.hexdigest()}"
    views = {line: json.loads(line)["keep_until_s"] for (*_, kind), line in lines.items() if kind == VIEW}
    kept = {line: until for line, until in views.items() if until > time.time()}
    with (
        tempfile.TemporaryDirectory(prefix="cspace-outcomes-") as scratch,
        tracking.start(OUTCOMES_EXPERIMENT, "outcomes, {id}", tags=tags, key=key) as run,
    ):
        copy = Path(scratch) / OUTCOMES_FILE
        copy.write_bytes(data)
        run.params({"models": sorted(models)[:_SHOWN_MODELS]})
        run.metrics(counts, 0)
        run.artifact(copy)
        if kept:
            # Before the file, so that none is there that nobody would delete.
            run.tags({TAG_KEEP_UNTIL: str(min(kept.values()))})
            beside = Path(scratch) / VIEWS_FILE
            with beside.open("wb") as file:
                file.writelines(kept)
            run.artifact(beside)
        run.dataset("outcomes", digest, f"runs:/{run.run_id}/{OUTCOMES_FILE}", "outcomes")
    return Upload(run.run_id, digest, counts)


def _row(path: Path, line: bytes) -> dict[str, Any]:
    with suppress(ValueError, RecursionError):
        row = json.loads(line)
        if isinstance(row, dict) and {"request_id", "kind", "model"} <= set(row):
            return row
    raise InputError(
        f"{path} is no file of outcomes",
        expected="a JSON object with request_id, kind and model on each line",
        got=repr(line[:80]),
        remedy="move it out of the folder",
    )


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Uploads what the setting names; returns the exit code."""
    from services.registry.mlflow_tracking import MlflowTracking  # noqa: PLC0415 - servers import this module

    argparse.ArgumentParser(
        prog="python -m services.outcomes",
        description=f"Upload what POST /outcomes was told from the folder {FOLDER} to MLFLOW_TRACKING_URI, "
        "and delete it there; delete kept pictures whose time is over.",
        epilog="Exit codes: 0 uploaded, or nothing to upload; 1 failed; 2 wrong request.",
    ).parse_args(arguments)
    folder, uri = Path(environment.get(FOLDER, "")), environment.get("MLFLOW_TRACKING_URI", "")
    try:
        if not uri or folder == Path() or not folder.is_dir():
            raise ConfigError(
                "the outcomes or the tracking server are not named",
                expected=f"{FOLDER}, the folder of a server, and MLFLOW_TRACKING_URI",
                got=f"the folder {str(folder)!r}, and {'an' if uri else 'no'} address",
                remedy='`eval "$(make -s env)"` sets both; a server makes the folder with the first outcome',
            )
        tracking = MlflowTracking(uri)
        for done in upload(folder, tracking):
            kinds = ", ".join(f"{number} of {kind}" for kind, number in sorted(done.counts.items()))
            sys.stdout.write(f"uploaded {kinds}; SHA-256 {done.digest}, run {done.run_id}\n")
        sys.stdout.write("no file of outcomes is left\n")
        if gone := forget(tracking):
            sys.stdout.write(f"deleted the kept pictures of {gone} batches, whose time was over\n")
    except CspaceError as error:
        return report_error(error, ConfigError)
    return 0


if __name__ == "__main__":
    sys.exit(main())
