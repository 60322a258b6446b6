"""Outcomes of answers, as users report them: receipts, a bounded database, and their upload to MLflow.

The answer of a plan carries a receipt of what the server stated. A report counts only with it, as what the
receipt says. A server commits reports to SQLite before it confirms them (:class:`Spool`), and
``python -m services.outcomes`` uploads them in batches, each of which becomes a run. The rows of a batch are
marked first, so that an interrupted upload goes on with the same batch and run.
"""

import argparse
import base64
import binascii
import hashlib
import hmac
import json
import logging
import os
import secrets
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from pathlib import Path
from queue import SimpleQueue
from threading import Event
from typing import TYPE_CHECKING, Any, Literal, get_args

import httpx
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cspace.errors import ConfigError, CspaceError, StorageError
from cspace.files import holding
from cspace.planning.cost import calibration_error
from services.commands import report_error
from services.names import OUTCOMES_EXPERIMENT, OUTCOMES_FILE, TAG_KEEP_UNTIL, TAG_STAGE, VIEW, VIEWS_FILE

if TYPE_CHECKING:
    import pandas as pd

    from services.registry.tracking import RunLog, Tracking

FOLDER = "CSPACE_OUTCOMES"
"""The setting that names the folder."""
# Written; refused because the disk does not get ready, because it refuses, because the share is full.
Result = Literal["kept", "busy", "storage", "space"]
RESULTS: tuple[Result, ...] = get_args(Result)

STAGE = "outcomes"
MAX_BATCH_BYTES = 32 * 2**20
CLIENT_SHARE = 0.25
"""Of the size that one client may fill."""
CLOCK_S, WAIT_S, _MOST_WAITING = 86_400.0, 5.0, 32
DATABASE, _KEY_FILE, _UPLOAD_LOCK = "outcomes.db", "receipts.key", ".upload.lock"
# Numbers that grow, for a clock may be set back; the triggers keep the size of what each client fills.
_SCHEMA = (
    """CREATE TABLE IF NOT EXISTS outcomes
    (number INTEGER PRIMARY KEY AUTOINCREMENT, client TEXT, keep_until_s INTEGER, batch TEXT, row BLOB)""",
    "CREATE TABLE IF NOT EXISTS used (client TEXT PRIMARY KEY, bytes INTEGER)",
    """CREATE TRIGGER IF NOT EXISTS added AFTER INSERT ON outcomes BEGIN
    INSERT INTO used VALUES (new.client, LENGTH(new.row))
    ON CONFLICT (client) DO UPDATE SET bytes = bytes + excluded.bytes; END""",
    """CREATE TRIGGER IF NOT EXISTS deleted AFTER DELETE ON outcomes BEGIN
    UPDATE used SET bytes = bytes - LENGTH(old.row) WHERE client = old.client; END""",
)
_INSERT = "INSERT INTO outcomes (client, keep_until_s, row) VALUES (?, ?, ?)"
_CLAIM = """
UPDATE outcomes SET batch = ? WHERE number IN (
  SELECT number FROM (SELECT number, SUM(LENGTH(row)) OVER (ORDER BY number) AS total FROM outcomes)
  WHERE total <= ? OR number = (SELECT MIN(number) FROM outcomes))
"""
_LOG = logging.getLogger(__name__)


class Claims(BaseModel):
    """What the server stated in an answer, and to whom; ``problem`` names its picture, start and goal."""

    model_config = ConfigDict(frozen=True)

    request_id: str
    model: str
    confidence: float | None
    client: str | None
    problem: str


class Receipts:
    """Issues receipts of answers, and checks those that come back: an HMAC over the claims."""

    def __init__(self, key: bytes) -> None:
        self._key = key

    @classmethod
    def of(cls, folder: Path, key: str = "") -> "Receipts":
        """By the given key, else by that of a folder, which is made once."""
        if key:
            return cls(hashlib.sha256(key.encode()).digest())
        path = _private(folder) / _KEY_FILE
        fresh = path.with_name(f".{secrets.token_hex(8)}.tmp")
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(secrets.token_bytes(32))
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileExistsError):
            os.link(fresh, path)
        fresh.unlink()
        return cls(path.read_bytes())

    def issue(
        self,
        request_id: str,
        model: str,
        version: int,
        confidence: float | None,
        client: str | None,
        problem: str = "",
    ) -> str:
        """The receipt of an answer."""
        claims = Claims(
            request_id=request_id,
            model=f"{model}/{version}",
            confidence=confidence,
            client=client,
            problem=problem,
        )
        said = base64.urlsafe_b64encode(claims.model_dump_json().encode()).decode()
        return f"{said}.{self._seal(said)}"

    def check(self, receipt: str) -> Claims | None:
        """What a receipt says; None where this key has not made it."""
        said, _, seal = receipt.partition(".")
        if not hmac.compare_digest(self._seal(said).encode(), seal.encode()):
            return None
        with suppress(ValidationError, binascii.Error):
            return Claims.model_validate_json(base64.urlsafe_b64decode(said))
        return None

    def _seal(self, said: str) -> str:
        return hmac.new(self._key, said.encode(), hashlib.sha256).hexdigest()


def problem_of(image: bytes, *ends: Iterable[float]) -> str:
    """A name of a picture with start and goal, to the tenth of a radian: what is solved again is the same."""
    rounded = [[round(value, 1) + 0.0 for value in end] for end in ends]
    return hashlib.sha256(image + json.dumps(rounded).encode()).hexdigest()[:16]


def matched(
    reports: Iterable[Mapping[str, Any]], receipts: Receipts, client: str | None
) -> list[dict[str, Any]]:
    """Reports as rows, joined with what was answered; a plan's without the receipt of its client is left out.

    Counts of samples have no receipt, and no fit uses them.
    """
    rows = []
    for report in reports:
        row = {**report, "client": client, "received_s": round(time.time(), 3)}
        receipt = row.pop("receipt", None)
        if row["kind"] == "plan":
            claims = receipts.check(receipt or "")
            if claims is None or (claims.client, claims.request_id) != (client, row["request_id"]):
                continue
            row |= claims.model_dump()
        rows.append(row)
    return rows


@dataclass(eq=False)
class _Write:
    """Outcomes of one client that wait to be written."""

    client: str
    lines: list[tuple[str, int | None, bytes]]
    result: Result | None = None
    done: Event = field(default_factory=Event)


class Spool:
    """Keeps outcomes in a folder, ``max_bytes`` of them at most; processes and threads may share it.

    ``count`` is called with a result and the number of outcomes.
    """

    def __init__(self, folder: Path, max_bytes: int, count: Callable[[Result, int], None]) -> None:
        self._folder, self._max_bytes, self._count = folder, max_bytes, count
        self._waiting: SimpleQueue[_Write] = SimpleQueue()
        # One thread writes, and takes all that waits at once.
        self._disk = ThreadPoolExecutor(1, "outcomes")

    def add(self, rows: Sequence[Mapping[str, Any]]) -> bool:
        """Write outcomes of one client, all or none; returns whether they are on disk.

        What comes while the disk is busy is written together. Who waits for a disk that hangs gives up.
        """
        if not rows:
            return True
        client = rows[0].get("client") or ""
        write = _Write(client, [(client, one.get("keep_until_s"), json.dumps(one).encode()) for one in rows])
        if self._waiting.qsize() < _MOST_WAITING:
            self._waiting.put(write)
            self._disk.submit(self._drain)
            write.done.wait(WAIT_S)
        result = write.result or "busy"
        self._count(result, len(rows))
        return result == "kept"

    def _drain(self) -> None:
        batch = [self._waiting.get() for _ in range(self._waiting.qsize())]
        if batch:
            self._write(batch)
        for write in batch:
            write.done.set()

    def _write(self, batch: Sequence[_Write]) -> None:
        kept = []
        try:
            with _database(self._folder) as database:
                used = Counter[str](dict(database.execute("SELECT client, bytes FROM used")))
                for write in batch:
                    size = sum(len(line) for _, _, line in write.lines)
                    fits = used[write.client] + size <= CLIENT_SHARE * self._max_bytes
                    if fits and used.total() + size <= self._max_bytes:
                        database.executemany(_INSERT, write.lines)
                        used[write.client] += size
                        kept.append(write)
                    else:
                        write.result = "space"
            for write in kept:
                write.result = "kept"
        except (OSError, sqlite3.Error) as error:
            busy = getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_BUSY
            _LOG.warning("outcomes are refused: %s", getattr(error, "strerror", None) or error)
            for write in batch:
                write.result = write.result or ("busy" if busy else "storage")

    def delete_expired(self, registry_uri: str) -> int:
        """Delete kept plans whose time is over, if the clock agrees with the registry's; returns how many."""
        return delete_expired(self._folder) if clock_agrees(registry_uri) else 0


@contextmanager
def _database(folder: Path) -> Iterator[sqlite3.Connection]:
    """A transaction in a folder's database, both for their owner alone; it is on disk when the block ends."""
    path = _private(folder) / DATABASE
    if not path.exists():
        os.close(os.open(path, os.O_RDWR | os.O_CREAT, 0o600))
    with closing(sqlite3.connect(path, WAIT_S, isolation_level=None)) as database:
        # What is deleted is gone from the file.
        for statement in ("PRAGMA auto_vacuum = FULL", "PRAGMA secure_delete = ON", "BEGIN IMMEDIATE"):
            database.execute(statement)
        with database:
            for statement in _SCHEMA:
                database.execute(statement)
            yield database


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


def clock_agrees(registry_uri: str) -> bool:
    """Whether the registry answers, and this machine's clock is within a day of its clock."""
    if not registry_uri.startswith(("http://", "https://")):
        return True
    try:
        there = httpx.get(f"{registry_uri.rstrip('/')}/health", timeout=5.0).headers["Date"]
        agrees = abs(time.time() - parsedate_to_datetime(there).timestamp()) < CLOCK_S
    except (httpx.HTTPError, KeyError, ValueError):
        return False
    if not agrees:
        _LOG.warning("the clock disagrees with the registry's by more than a day: nothing expires")
    return agrees


def delete_expired(folder: Path) -> int:
    """Delete kept plans whose time is over; returns how many."""
    with _database(folder) as database:
        return database.execute("DELETE FROM outcomes WHERE keep_until_s <= ?", (time.time(),)).rowcount


class Row(BaseModel):
    """One outcome, as uploaded."""

    model_config = ConfigDict(frozen=True)

    kind: Literal["plan", "samples"]
    request_id: str
    client: str | None = None
    model: str
    confidence: float | None = Field(None, ge=0.0, le=1.0)
    problem: str = ""
    site: str | None = None
    success: bool | None = None
    executed: bool | None = None
    collided: bool | None = None
    collided_at: float | None = Field(None, ge=0.0, le=1.0)
    checked: int | None = None
    free: int | None = None
    novelty: float | None = None
    time_s: float | None = None
    stamp_s: float | None = None
    received_s: float | None = None

    @property
    def key(self) -> tuple[str | None, str, str]:
        """What is reported twice counts once."""
        return self.client, self.request_id, self.kind


@dataclass(frozen=True, slots=True)
class Upload:
    """One batch that the tracking server holds: its run, its file's SHA-256, rows by kind, bad lines."""

    run_id: str
    digest: str
    counts: Mapping[str, int]
    bad: int


def upload(folder: Path, tracking: "Tracking") -> Iterator[Upload]:
    """Upload the outcomes of a folder in batches, and delete each batch after it was uploaded."""
    busy = StorageError("another process uploads these outcomes", remedy="wait until it is done")
    try:
        with holding(folder / _UPLOAD_LOCK, busy):
            while claimed := _claim(folder):
                yield _upload(*claimed, tracking)
                with _database(folder) as database:
                    database.execute("DELETE FROM outcomes WHERE batch = ?", claimed[:1])
    except (OSError, sqlite3.Error) as error:
        raise StorageError(
            "the outcomes cannot be read or deleted",
            expected="room and rights in their folder and for temporary files",
            got=getattr(error, "strerror", None) or str(error),
        ) from error


def _claim(folder: Path) -> tuple[str, list[tuple[bytes, int | None]]] | None:
    """The next batch, or an interrupted one: its name, and each line with when it expires."""
    with _database(folder) as database:
        marked = database.execute("SELECT batch FROM outcomes WHERE batch IS NOT NULL LIMIT 1").fetchone()
        batch = marked[0] if marked else secrets.token_hex(16)
        if not marked:
            database.execute(_CLAIM, (batch, MAX_BATCH_BYTES))
        query = "SELECT row, keep_until_s FROM outcomes WHERE batch = ? ORDER BY number"
        lines = database.execute(query, (batch,)).fetchall()
    return (batch, lines) if lines else None


def _upload(batch: str, lines: Iterable[tuple[bytes, int | None]], tracking: "Tracking") -> Upload:
    import pandas as pd  # noqa: PLC0415 - servers import this module

    rows, bad, kept = dict[Any, Row](), 0, dict[bytes, int]()
    for line, until_s in lines:
        if until_s is not None:
            kept[line] = until_s
            continue
        try:
            row = Row.model_validate_json(line)
            rows[row.key] = row
        except ValidationError:
            bad += 1
    counts = Counter[str](row.kind for row in rows.values())
    with (
        tempfile.TemporaryDirectory(prefix="cspace-outcomes-") as scratch,
        tracking.start(
            OUTCOMES_EXPERIMENT, "outcomes, {id}", tags={TAG_STAGE: STAGE}, key=f"outcomes/{batch}"
        ) as run,
    ):
        counts[VIEW] = len(kept)
        run.metrics({**counts, "bad": bad}, 0)
        path = Path(scratch) / OUTCOMES_FILE
        table = pd.DataFrame([row.model_dump() for row in rows.values()], columns=[*Row.model_fields])
        table.convert_dtypes().to_parquet(path, index=False)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        run.artifact(path)
        if kept:
            # Before the file, so that none is there that nobody would delete.
            run.tags({TAG_KEEP_UNTIL: str(min(kept.values()))})
            views = Path(scratch) / VIEWS_FILE
            views.write_bytes(b"".join(line + b"\n" for line in kept))
            run.artifact(views)
        log_reliability(run, table)
        run.dataset("outcomes", digest, f"runs:/{run.run_id}/{OUTCOMES_FILE}", "outcomes")
    return Upload(run.run_id, digest, +counts, bad)


def uploaded(tracking: "Tracking") -> Iterator[tuple[str, str, list[Row]]]:
    """All batches that the tracking server holds, the oldest first: run id, SHA-256, outcomes.

    Rows that are none are left out.
    """
    from pyarrow import parquet  # noqa: PLC0415 - servers import this module

    for run_id, path in run_files(tracking, OUTCOMES_FILE):
        rows = []
        for values in parquet.read_table(path).to_pylist():
            with suppress(ValidationError):
                rows.append(Row.model_validate(values))
        yield run_id, hashlib.sha256(path.read_bytes()).hexdigest(), rows


def run_files(tracking: "Tracking", name: str) -> Iterator[tuple[str, Path]]:
    """A file of all batches that have it, the oldest first: run id, and its copy."""
    for run in reversed(tracking.finished(OUTCOMES_EXPERIMENT)):
        with tempfile.TemporaryDirectory(prefix="cspace-outcomes-") as scratch:
            path = tracking.file(run.info.run_id, name, Path(scratch))
            if path is not None:
                yield run.info.run_id, path


def log_reliability(run: "RunLog", reports: "pd.DataFrame") -> None:
    """A figure and a table of stated confidence against what happened, per model and site.

    The figure shows the share of free plans over the confidence, in bins of equal number.
    """
    import pandas as pd  # noqa: PLC0415 - servers import this module
    from matplotlib.figure import Figure  # noqa: PLC0415 - as above

    plans = reports[reports["kind"] == "plan"].dropna(subset=["confidence", "collided"])
    if plans.empty:
        return
    plans = plans.assign(site=plans["site"].fillna(""), free=~plans["collided"].astype(bool))
    figure, rows = Figure((5.5, 4.0), layout="constrained"), []
    axes = figure.subplots()
    axes.plot((0, 1), (0, 1), color="0.7", linewidth=1)
    for (model, site), own in plans.groupby(["model", "site"]):
        stated, free = own["confidence"].to_numpy(dtype=np.float64), own["free"].to_numpy()
        bins = np.array_split(np.argsort(stated), max(1, min(10, len(own) // 10)))
        label = f"{model} {site}, {len(own)} plans"
        axes.plot([stated[one].mean() for one in bins], [free[one].mean() for one in bins], "o-", label=label)
        rows.append((model, site, len(own), stated.mean(), free.mean(), calibration_error(stated, free)))
    axes.set(xlabel="stated confidence", ylabel="share that was free", xlim=(0, 1), ylim=(0, 1))
    axes.legend(fontsize="small")
    run.figure(figure, "reliability")
    columns = ["model", "site", "plans", "confidence", "free", "calibration_error"]
    run.table(dict(pd.DataFrame(rows, columns=columns).to_dict("list")), "reliability")


def forget(tracking: "Tracking") -> int:
    """Delete uploaded pictures whose time is over; returns of how many batches."""
    count = 0
    for run in tracking.finished(OUTCOMES_EXPERIMENT):
        until = run.data.tags.get(TAG_KEEP_UNTIL)
        if until and float(until) <= time.time():
            tracking.remove_file(run.info.run_id, VIEWS_FILE)
            tracking.note(run.info.run_id, {TAG_KEEP_UNTIL: ""})
            count += 1
    return count


def _private(folder: Path) -> Path:
    """A folder that is there, for its owner alone."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with suppress(PermissionError):
        folder.chmod(0o700)
    return folder


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Delete what expired, upload what the setting names; returns the exit code."""
    from services.registry.errors import check_reachable  # noqa: PLC0415 - servers import this module
    from services.registry.tracking import Tracking  # noqa: PLC0415 - as above

    argparse.ArgumentParser(
        prog="python -m services.outcomes",
        description="Delete kept pictures whose time is over, here and in MLflow, and upload what POST "
        f"/outcomes was told from the folder {FOLDER} to MLFLOW_TRACKING_URI.",
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
        # MLflow itself would try for minutes.
        check_reachable(uri, WAIT_S)
        tracking, here, there = Tracking(uri), 0, 0
        if clock_agrees(uri):
            here, there = delete_expired(folder), forget(tracking)
        if here or there:
            sys.stdout.write(
                f"deleted {here} kept plans, and the pictures of {there} batches: time is over\n"
            )
        for done in upload(folder, tracking):
            kinds = ", ".join(f"{number} of {kind}" for kind, number in sorted(done.counts.items()))
            skipped = f"; skipped {done.bad} bad lines" if done.bad else ""
            sys.stdout.write(f"uploaded {kinds}{skipped}; SHA-256 {done.digest}, run {done.run_id}\n")
        sys.stdout.write("no file of outcomes is left\n")
    except CspaceError as error:
        return report_error(error, ConfigError)
    return 0


if __name__ == "__main__":
    sys.exit(main())
