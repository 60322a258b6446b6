"""Receipts, the folder of outcomes and their upload: what is confirmed stays, and what is forged is out."""

import json
import resource
import sqlite3
import stat
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest

from cspace.errors import StorageError
from cspace.files import holding
from services import outcomes
from services.names import OUTCOMES_FILE, TAG_KEEP_UNTIL, VIEWS_FILE
from services.outcomes import (
    DATABASE,
    Receipts,
    Spool,
    clock_agrees,
    delete_expired,
    forget,
    matched,
    problem_of,
    upload,
    uploaded,
    view_row,
)
from tests.fakes.registry import FakeTracking
from tests.services.registry.strange_server import strange_server

MIB = 2**20


def report(number=0, **more):
    return {"kind": "plan", "request_id": f"r{number}", "success": True, "collided": False} | more


def rows_in(folder):
    with closing(sqlite3.connect(folder / DATABASE)) as database:
        return [json.loads(line) for (line,) in database.execute("SELECT row FROM outcomes ORDER BY number")]


@pytest.fixture
def counts():
    return Counter()


@pytest.fixture
def spool(tmp_path, counts):
    return Spool(tmp_path / "outcomes", 16 * MIB, lambda result, number: counts.update({result: number}))


def row(number=0, client="one", **more):
    return {**report(number), "client": client, "model": "m/1", "confidence": 0.5, **more}


def test_a_report_counts_with_the_receipt_of_its_answer_alone(tmp_path):
    receipts = Receipts.of(tmp_path / "outcomes")
    receipt = receipts.issue("r0", "m", 3, 0.25, "one", problem_of(b"png", (0.0, 1.0), (1.0, 0.0)))
    [found] = matched([report(confidence=0.999, model="other/9", receipt=receipt)], receipts, "one")
    assert (found["confidence"], found["model"], found["client"]) == (0.25, "m/3", "one")
    said, _, seal = receipt.partition(".")
    forged = [
        report(),
        report(receipt=""),
        report(receipt="é.ü"),
        report(receipt=f"{said}.{seal[:-1]}x"),
        report(receipt=f"{said[:-4]}AAAA.{seal}"),
        report(receipt=Receipts(b"another").issue("r0", "m", 3, 0.99, "one")),
        report(1, receipt=receipt),
    ]
    assert matched(forged, receipts, "one") == []
    assert matched([report(receipt=receipt)], receipts, "two") == []
    # Servers that share the folder or the secret take each other's.
    assert Receipts.of(tmp_path / "outcomes").check(receipt) == receipts.check(receipt)
    assert Receipts.of(tmp_path, "secret").check(
        Receipts.of(tmp_path, "secret").issue("r", "m", 1, None, None)
    )
    assert stat.S_IMODE((tmp_path / "outcomes" / "receipts.key").stat().st_mode) == 0o600


def test_a_problem_is_the_same_by_its_picture_and_its_ends():
    name = problem_of(b"a", (0.0, 1.0), (2.0, 3.0))
    assert problem_of(b"a", np.array([0.01, 1.02]), (2.0, 3.0)) == name
    assert (
        len({name, problem_of(b"b", (0.0, 1.0), (2.0, 3.0)), problem_of(b"a", (0.0, 1.0), (2.0, 3.5))}) == 3
    )


def test_what_is_confirmed_is_on_disk_for_the_owner_alone(spool, tmp_path, counts):
    folder = tmp_path / "outcomes"
    assert spool.add([row(0), row(1)])
    assert spool.add([row(2, client="a/../b")])
    assert [one["request_id"] for one in rows_in(folder)] == ["r0", "r1", "r2"]
    modes = {stat.S_IMODE(path.stat().st_mode) for path in folder.rglob("*") if path.is_file()}
    folders = {stat.S_IMODE(path.stat().st_mode) for path in (folder, *folder.iterdir()) if path.is_dir()}
    assert (modes, folders, counts) == ({0o600}, {0o700}, Counter(kept=3))


KILLED = """
import sys, threading
from pathlib import Path
from services.outcomes import Spool
spool = Spool(Path(sys.argv[1]), 2**24, lambda *_: None)
def send(thread):
    for number in range(10**6):
        name = f"{thread}.{number}"
        if spool.add([{"kind": "plan", "request_id": name, "client": f"c{thread % 2}", "model": "m/1"}]):
            sys.stdout.write(name + "\\n")
            sys.stdout.flush()
threads = [threading.Thread(target=send, args=(thread,)) for thread in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


def test_a_server_that_is_killed_has_lost_nothing_that_it_confirmed(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        confirmed = [server.stdout.readline().strip() for _ in range(200)]
        server.kill()
        confirmed += server.stdout.read().split("\n")[:-1]
    tracking = FakeTracking()
    list(upload(tmp_path, tracking))
    [(_, _, rows)] = uploaded(tracking)
    assert set(confirmed) <= {one.request_id for one in rows}


def test_a_full_disk_refuses_what_it_cannot_keep_and_keeps_the_rest(spool, tmp_path, counts):
    assert spool.add([row(0)])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / "outcomes" / DATABASE).stat().st_size, hard))
    try:
        assert not spool.add([row(number, pad="x" * 5000) for number in range(1, 100)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert spool.add([row(100)])
    assert [one["request_id"] for one in rows_in(tmp_path / "outcomes")] == ["r0", "r100"]
    assert counts == Counter(kept=2, storage=99)


def test_who_waits_for_the_disk_gives_up_after_a_bounded_time(spool, tmp_path, monkeypatch, counts):
    assert spool.add([row(0)])
    monkeypatch.setattr(outcomes, "WAIT_S", 0.2)
    with closing(sqlite3.connect(tmp_path / "outcomes" / DATABASE, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        began = time.monotonic()
        with ThreadPoolExecutor(16) as pool:
            assert not any(pool.map(lambda number: spool.add([row(number)]), range(1, 17)))
        assert time.monotonic() - began < 5.0
    assert spool.add([row(64)])
    assert counts == Counter(kept=2, busy=16)


def test_ten_thousand_outcomes_a_minute_are_kept(spool):
    began = time.monotonic()
    with ThreadPoolExecutor(16) as pool:
        assert all(pool.map(lambda number: spool.add([row(number)] * 5), range(500)))
    assert time.monotonic() - began < 2500 / 10_000 * 60


def test_a_client_fills_its_share_and_no_more_and_nothing_confirmed_is_deleted(
    spool, tmp_path, monkeypatch, counts
):
    # A clock that is a year ahead for a while changes nothing.
    monkeypatch.setattr(time, "time", lambda now=time.time: now() + 365 * 86_400)
    batch = [row(number, pad="x" * 900) for number in range(950)]
    taken = [spool.add(batch) for _ in range(16)]
    monkeypatch.undo()
    assert 3 <= sum(taken) <= 4
    assert taken == sorted(taken, reverse=True)
    assert spool.add([row(0, client="two")])
    assert sum(one["client"] == "one" for one in rows_in(tmp_path / "outcomes")) == 950 * sum(taken)
    assert counts["space"] == 950 * (16 - sum(taken))


def view(number, keep_s):
    kept = view_row("m/1", "robot", b"png", np.zeros((2, 2)), keep_s)
    return {"request_id": f"r{number}", "client": "one", **kept}


def views_in(folder):
    return [one for one in rows_in(folder) if one["kind"] == "view"]


def test_kept_pictures_expire_by_a_clock_that_agrees_with_the_registrys(spool, tmp_path, monkeypatch):
    folder = tmp_path / "outcomes"
    assert spool.add([view(0, -10.0)])
    assert spool.add([view(1, 2 * 86_400.0)])
    # While the registry is away nothing expires, for it does not say its time.
    assert spool.delete_expired("http://127.0.0.1:1") == 0
    # The clock of this module alone: the server's stays right.
    late = SimpleNamespace(**vars(time) | {"time": lambda: time.time() + 3 * 86_400})
    with strange_server(200, b"") as uri:
        registry = uri.replace("//", "//user:secret@")
        with monkeypatch.context() as patch:
            patch.setattr(outcomes, "time", late)
            assert not clock_agrees(registry)
            assert spool.delete_expired(registry) == 0
        assert len(views_in(folder)) == 2
        assert spool.delete_expired(registry) == 1
    assert len(views_in(folder)) == 1


def test_uploaded_pictures_are_deleted_when_their_time_is_over(spool, tmp_path, monkeypatch):
    tracking = FakeTracking()
    assert spool.add([view(0, 60.0)])
    assert spool.add([row(1)])
    [done] = upload(tmp_path / "outcomes", tracking)
    assert done.counts == {"plan": 1, "view": 1}
    run = tracking.runs[done.run_id]
    assert json.loads(run.artifacts[VIEWS_FILE])["request_id"] == "r0"
    assert forget(tracking) == 0
    late = SimpleNamespace(**vars(time) | {"time": lambda: time.time() + 61.0})
    monkeypatch.setattr(outcomes, "time", late)
    assert forget(tracking) == 1
    assert VIEWS_FILE not in run.artifacts
    assert (run.tags[TAG_KEEP_UNTIL], forget(tracking)) == ("", 0)
    assert delete_expired(tmp_path / "outcomes") == 0


def test_a_batch_is_parquet_with_each_report_once_its_last_words_and_a_reliability(spool, tmp_path):
    tracking, folder = FakeTracking(), tmp_path / "outcomes"
    for number in range(40):
        spool.add([row(number, collided=number % 2 == 0, site="cell-4")])
    spool.add([row(0, collided=False, site="cell-4"), row(0, client="two", collided=True)])
    # Neither half a line nor a row that is none holds the others up.
    bad = (b'{"kind": "plan", "request_id": 7}', b"[" * 10_000, b"\xff", b'{"kind": "pl')
    with closing(sqlite3.connect(folder / DATABASE)) as database, database:
        database.executemany("INSERT INTO outcomes (client, row) VALUES ('one', ?)", [(one,) for one in bad])
    [done] = upload(folder, tracking)
    assert (done.counts, done.bad) == ({"plan": 41}, 4)
    assert rows_in(folder) == []
    [(_, digest, rows)] = uploaded(tracking)
    assert digest == done.digest
    assert next(one for one in rows if one.key == ("one", "r0", "plan")).collided is False
    artifacts = tracking.runs[done.run_id].artifacts
    assert {OUTCOMES_FILE, "figures/reliability.png", "tables/reliability.json"} <= set(artifacts)
    table = json.loads(artifacts["tables/reliability.json"])
    assert [line[:3] for line in table["data"]] == [["m/1", "", 1], ["m/1", "cell-4", 40]]


def test_an_interrupted_upload_goes_on_with_its_batch_and_run(spool, tmp_path):
    tracking, folder = FakeTracking(), tmp_path / "outcomes"
    spool.add([row(0)])
    # Killed after the run has ended and before its rows are deleted.
    assert next(upload(folder, tracking)).counts == {"plan": 1}
    spool.add([row(1)])
    first, second = upload(folder, tracking)
    assert (len(tracking.runs), first.counts, second.counts) == (2, {"plan": 1}, {"plan": 1})
    with holding(folder / ".upload.lock", StorageError("held")), pytest.raises(StorageError):
        list(upload(folder, tracking))
