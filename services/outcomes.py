"""Outcomes of answers, as users report them: a bounded folder of files, and their upload to MLflow.

A server gathers outcomes in memory and writes them as whole files, one JSON object per line
(:class:`Spool`). ``python -m services.outcomes`` uploads the files as data sets and deletes them. A batch is
moved into a folder of its own first, and stays there until it is uploaded. After an interruption the same
batch is therefore uploaded again, into the same run.
"""

import argparse
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

from cspace.errors import ConfigError, CspaceError, InputError, StorageBusyError, StorageError
from cspace.files import HALF_PREFIX, HALF_SUFFIX, discard, holding, replacing
from services.command_errors import report_error
from services.names import OUTCOMES_EXPERIMENT, OUTCOMES_FILE, TAG_STAGE
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
    with tempfile.TemporaryDirectory(prefix="cspace-outcomes-") as scratch:
        for run in reversed(tracking.finished(OUTCOMES_EXPERIMENT)):
            path = tracking.file(run.run_id, OUTCOMES_FILE, Path(scratch) / run.run_id)
            data = b"" if path is None else path.read_bytes()
            yield run.run_id, hashlib.sha256(data).hexdigest(), [*map(json.loads, data.splitlines())]


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
    data = b"".join(lines.values())
    digest, counts = hashlib.sha256(data).hexdigest(), Counter(kind for *_, kind in lines)
    key, tags = f"outcomes/{digest}", {TAG_STAGE: STAGE}
    with (
        tempfile.TemporaryDirectory(prefix="cspace-outcomes-") as scratch,
        tracking.start(OUTCOMES_EXPERIMENT, "outcomes, {id}", tags=tags, key=key) as run,
    ):
        copy = Path(scratch) / OUTCOMES_FILE
        copy.write_bytes(data)
        run.params({"models": sorted(models)[:_SHOWN_MODELS]})
        run.metrics(counts, 0)
        run.artifact(copy)
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
        "and delete it there.",
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
        for done in upload(folder, MlflowTracking(uri)):
            kinds = ", ".join(f"{number} of {kind}" for kind, number in sorted(done.counts.items()))
            sys.stdout.write(f"uploaded {kinds}; SHA-256 {done.digest}, run {done.run_id}\n")
        sys.stdout.write("no file of outcomes is left\n")
    except CspaceError as error:
        return report_error(error, ConfigError)
    return 0


if __name__ == "__main__":
    sys.exit(main())
