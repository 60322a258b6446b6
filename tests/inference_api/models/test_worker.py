"""A registry that never comes to an end, and a bundle that attacks, do not delay the default's answers."""

import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from multiprocessing import resource_tracker
from pathlib import Path

import psutil
import pytest

from cspace.bundle import verification
from cspace.bundle.files import read_files
from cspace.errors import CspaceError, RegistryUnavailableError
from inference_api.models.cache import BundleCache, DiskCache
from inference_api.models.served import ShippedModels
from inference_api.models.store import ModelStore, Refusal
from inference_api.models.worker import RegistryWorker
from services.registry.entities import PRETRAINED, ModelReference, ModelVersion
from tests.inference_api.bad_bundles import write_hungry_bundle, write_slow_bundle
from tests.inference_api.trickling import Kind, trickling
from tests.services.registry.strange_server import strange_server

# A worker imports MLflow.
pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[3]
LIMIT_S = 1.5
MODEL = "cspace-sampler"
DEFAULT, NAMED = ModelReference(MODEL), ModelReference(MODEL, version=1)
ABSENT = ModelVersion("m", 1, "", "a" * 64, (), {}, 0)
SECRETS = ("secret", "user:", "127.0.0.1", "/srv/")
MakeWorker = Callable[[str], RegistryWorker]


@pytest.fixture
def make_worker() -> Iterator[MakeWorker]:
    """Workers over an address ``HOST:PORT``, asked with a user and a password."""
    with ExitStack() as stack:

        def make(place: str) -> RegistryWorker:
            worker = RegistryWorker(f"http://user:secret@{place}", LIMIT_S, LIMIT_S)
            stack.callback(worker.close)
            return worker

        yield make


@pytest.fixture
def silent() -> Iterator[str]:
    """A registry that never answers."""
    with trickling("silent") as place:
        yield place


def store_of(
    worker: RegistryWorker, folder: Path, shipped: Path, verify_s: float = verification.VERIFY_S
) -> ModelStore:
    def verify(bundle: Path, digest: str) -> None:
        verification.verify(bundle, digest, verify_s)

    cache = BundleCache(DiskCache(folder / "cache"), worker, verify, 2)
    store = ModelStore(worker, cache, ShippedModels({PRETRAINED: shipped}), MODEL, wait_s=60.0)
    store.load_shipped()
    return store


def processes() -> set[int]:
    """Of this one; the tracker of multiprocessing is one of them from the first start on."""
    resource_tracker.ensure_running()
    return {process.pid for process in psutil.Process().children(recursive=True)}


def resolve_anyway(store: ModelStore) -> None:
    with pytest.raises(CspaceError):
        store.resolve(NAMED)


def clean(error: BaseException | None) -> None:
    """Neither it nor whatever a traceback would show of its causes."""
    while error is not None:
        assert not [secret for secret in SECRETS if secret in str(error)], str(error)
        error = error.__cause__ or error.__context__


@pytest.mark.parametrize("kind", ["header", "body"])
def test_a_lookup_that_never_ends_is_given_up_and_its_process_is_gone(
    make_worker: MakeWorker, kind: Kind
) -> None:
    before = processes()
    with trickling(kind) as place:
        worker = make_worker(place)
        with pytest.raises(RegistryUnavailableError, match="takes too long") as caught:
            worker.version(MODEL, 1)
        assert worker.pid is None
        assert processes() <= before
        clean(caught.value)


def test_a_process_that_is_killed_is_followed_by_another(make_worker: MakeWorker, silent: str) -> None:
    worker = make_worker(silent)
    worker.start()
    pid = worker.pid
    assert pid is not None
    threading.Timer(0.5, os.kill, (pid, signal.SIGKILL)).start()
    with pytest.raises(RegistryUnavailableError, match="has ended"):
        worker.by_alias(MODEL, "champion")
    # Not at once: one that fails again and again would take a core.
    with pytest.raises(RegistryUnavailableError, match="a moment ago"):
        worker.by_alias(MODEL, "champion")
    threading.Event().wait(1.1)
    worker.start()
    assert worker.pid not in (None, pid)


ORPHAN = """
import os, sys, threading
from inference_api.models.worker import RegistryWorker
worker = RegistryWorker(sys.argv[1], 600.0)
worker.start()
print(worker.pid, flush=True)
threading.Timer(4.0, os._exit, (7,)).start()
worker.version("m", 1)
"""


def test_a_worker_in_the_middle_of_a_call_ends_when_its_parent_dies(silent: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ORPHAN, f"http://{silent}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 7, done.stderr
    pid, until_s = int(done.stdout), time.monotonic() + 10.0
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < until_s, "it lives on"
        threading.Event().wait(0.02)


def test_a_worker_is_held_by_the_kernel(make_worker: MakeWorker, closed_place: str) -> None:
    worker = make_worker(closed_place)
    with pytest.raises(RegistryUnavailableError):
        worker.version("m", 1)
    process = psutil.Process(worker.pid)
    soft, hard = process.rlimit(psutil.RLIMIT_AS)
    assert soft == hard < process.memory_info().vms + 2**30
    assert process.rlimit(psutil.RLIMIT_CORE) == (0, 0)
    assert process.rlimit(psutil.RLIMIT_FSIZE)[1] <= 2**30
    assert os.getpgid(process.pid) == process.pid
    # The kernel shares cores out among sessions: one of its own could be left without any.
    assert os.getsid(process.pid) == os.getsid(0)


def test_closing_the_store_ends_whoever_waits_for_the_registry_and_every_process(
    make_worker: MakeWorker, tmp_path: Path, bundles: dict[str, Path], silent: str
) -> None:
    before, worker = processes(), make_worker(silent)
    store = store_of(worker, tmp_path, bundles["shipped"])
    store.start()
    thread = threading.Thread(target=resolve_anyway, args=(store,))
    thread.start()
    store.close()
    thread.join(LIMIT_S)
    assert not thread.is_alive()
    assert processes() <= before
    with pytest.raises(RegistryUnavailableError, match="shutting down"):
        worker.version(MODEL, 2)


def test_a_download_that_never_ends_is_given_up_and_leaves_nothing(
    make_worker: MakeWorker, tmp_path: Path
) -> None:
    disk = DiskCache(tmp_path / "cache")
    with trickling("body") as place, pytest.raises(RegistryUnavailableError) as caught:
        disk.download(ABSENT, make_worker(place).download)
    clean(caught.value)
    assert list((tmp_path / "cache" / "m").iterdir()) == []


@pytest.fixture
def closed_place() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


@pytest.mark.parametrize("kind", ["closed", "failing", "telling", "refusing"])
def test_no_error_and_no_line_of_the_log_tells_the_registrys_address_or_password(
    make_worker: MakeWorker,
    tmp_path: Path,
    bundles: dict[str, Path],
    closed_place: str,
    caplog: pytest.LogCaptureFixture,
    kind: str,
) -> None:
    body = b'{"error_code": "%s", "message": "http://user:secret@127.0.0.1:1/x, see /srv/mlruns/1"}'
    with ExitStack() as stack, caplog.at_level(logging.DEBUG):
        place = closed_place
        if kind != "closed":
            status, code = {"failing": (500, b"INTERNAL_ERROR"), "telling": (404, b"OTHER")}.get(
                kind, (403, b"http://user:secret@127.0.0.1")
            )
            server = strange_server(status, body % code, probe_is_well=kind != "failing")
            place = stack.enter_context(server).removeprefix("http://")
        store = store_of(make_worker(place), tmp_path, bundles["shipped"])
        store.refresh()
        with pytest.raises(CspaceError) as caught:
            store.resolve(NAMED)
        clean(caught.value)
        assert store.versions(NAMED.name) == []
    assert "the registry does not answer" in caplog.text
    assert not [secret for secret in SECRETS if secret in caplog.text]


@pytest.mark.parametrize(
    ("write", "verify_s", "reason"),
    [
        (write_slow_bundle, 2.0, "the bundle does not stand its verification"),
        (write_hungry_bundle, 60.0, "encoder.onnx cannot be opened"),
    ],
)
def test_a_champion_that_attacks_is_refused_in_time_and_takes_nothing_of_this_process(
    make_worker: MakeWorker,
    closed_place: str,
    tmp_path: Path,
    bundles: dict[str, Path],
    caplog: pytest.LogCaptureFixture,
    write: Callable[[Path], Path],
    verify_s: float,
    reason: str,
) -> None:
    # The registry is away, so that the last champion that was known is the one to serve.
    disk, bundle = DiskCache(tmp_path / "cache"), write(tmp_path / "bad")
    champion = ModelVersion(MODEL, 1, "", read_files(bundle).digest, ("champion",), {}, 0)
    disk.download(champion, lambda _, folder: Path(shutil.copytree(bundle, folder)))
    disk.remember_champion(champion)
    before = processes()
    store = store_of(make_worker(closed_place), tmp_path, bundles["shipped"], verify_s)
    seen: list[Refusal | None] = []
    store.on_champion = seen.append
    memory_bytes = psutil.Process().memory_info().rss
    with caplog.at_level(logging.WARNING):
        looking = threading.Thread(target=store.refresh, daemon=True)
        looking.start()
        slowest_s = 0.0
        while looking.is_alive():
            began_s = time.perf_counter()
            assert store.resolve(DEFAULT).fallback
            slowest_s = max(slowest_s, time.perf_counter() - began_s)
            looking.join(0.01)
    # Nobody waits for the verification.
    assert slowest_s < 2.0
    assert f"{MODEL}/1 cannot follow: {reason}" in caplog.text
    assert str(tmp_path) not in caplog.text
    # It was taken off the disk, and cannot be had again while the registry is away.
    assert store.successor == "refused"
    assert disk.stored(MODEL) == []
    assert seen == ["bundle"]
    assert psutil.Process().memory_info().rss - memory_bytes < 20 * 2**20
    store.close()
    assert processes() <= before
