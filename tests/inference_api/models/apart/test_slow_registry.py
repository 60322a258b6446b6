"""A registry that never comes to an end takes neither the default's answers, nor threads, nor secrets."""

import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from cspace.errors import CspaceError, RegistryError, RegistryUnavailableError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.parts import Limits, Parts, parts_apart
from inference_api.models.apart.processes.child import ChildLimits
from inference_api.models.bundle_cache import BundleCache
from inference_api.models.shipped import ShippedModels
from inference_api.models.store import ModelStore
from services.registry.models.port import ModelVersion
from services.registry.references import PRETRAINED, ModelReference
from tests.inference_api.trickling import Kind, trickling
from tests.services.registry.strange_server import strange_server

LIMIT_S = 1.5
# Less than any look at the registry takes before it is given up.
QUICK_S = 1.0
DEFAULT = ModelReference("cspace-sampler")
NAMED = ModelReference("cspace-sampler", version=1)
Apart = Callable[[str], Parts]
SECRETS = ("secret", "user:", "127.0.0.1", "/srv/")


@pytest.fixture
def apart(tmp_path: Path) -> Iterator[Apart]:
    """Parts over an address ``HOST:PORT``, asked with a user and a password."""
    with ExitStack() as stack:

        def make(place: str) -> Parts:
            limits = Limits(LIMIT_S, LIMIT_S, LIMIT_S, ChildLimits())
            parts = parts_apart(DiskCache(tmp_path / "cache"), f"http://user:secret@{place}", limits)
            for child in parts.children:
                stack.callback(child.close)
            return parts

        yield make


def store_of(parts: Parts, folder: Path, shipped: Path, wait_s: float = 60.0) -> ModelStore:
    cache = BundleCache(DiskCache(folder / "cache"), parts.loader, 2)
    store = ModelStore(
        parts.registry,
        cache,
        ShippedModels({PRETRAINED: shipped}),
        "cspace-sampler",
        wait_s=wait_s,
        children=parts.children,
    )
    store.load_shipped()
    return store


@pytest.fixture
def closed_place() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


@pytest.mark.parametrize("kind", ["header", "body"])
def test_a_lookup_that_never_ends_is_given_up_and_its_process_is_gone(apart: Apart, kind: Kind) -> None:
    with trickling(kind) as place:
        parts = apart(place)
        registry = parts.registry
        assert registry is not None
        with pytest.raises(RegistryUnavailableError, match="takes too long") as caught:
            registry.version("cspace-sampler", 1)
        assert parts.children[0].pid is None
        clean(caught.value)


def test_the_default_is_answered_at_once_while_the_registry_trickles(
    apart: Apart, tmp_path: Path, bundles: dict[str, Path]
) -> None:
    with trickling() as place:
        store = store_of(apart(place), tmp_path, bundles["shipped"])
        waiting = [threading.Thread(target=resolve_anyway, args=(store,), daemon=True) for _ in range(8)]
        looking = threading.Thread(target=store.refresh, daemon=True)
        for thread in (looking, *waiting):
            thread.start()
        asked = 0
        while looking.is_alive():
            began_s = time.perf_counter()
            assert store.resolve(DEFAULT).name == "pretrained"
            assert time.perf_counter() - began_s < QUICK_S
            asked += 1
            looking.join(0.01)
        assert asked > 10
        assert store.registry_state == "unreachable"
        # Those that named a version are told, too, and none of them stays behind.
        for thread in waiting:
            thread.join(4 * LIMIT_S)
            assert not thread.is_alive()


def test_closing_the_store_ends_whoever_waits_for_the_registry_and_every_process(
    apart: Apart, tmp_path: Path, bundles: dict[str, Path]
) -> None:
    before = {process.pid for process in psutil.Process().children(recursive=True)}
    with trickling("silent") as place:
        parts = apart(place)
        store = store_of(parts, tmp_path, bundles["shipped"])
        store.start()
        thread = threading.Thread(target=resolve_anyway, args=(store,))
        thread.start()
        store.close()
        thread.join(LIMIT_S)
        assert not thread.is_alive()
    assert {process.pid for process in psutil.Process().children(recursive=True)} <= before


def test_a_download_that_never_ends_is_given_up_and_leaves_nothing(apart: Apart, tmp_path: Path) -> None:
    version = ModelVersion("m", 1, "", "a" * 64, (), {}, 0)
    with trickling("body") as place:
        with pytest.raises(RegistryUnavailableError) as caught:
            apart(place).loader.download(version)
        clean(caught.value)
    # What the process that was ended has left goes with the next change.
    with pytest.raises(RegistryError):
        DiskCache(tmp_path / "cache").download(version, refuse)
    assert list((tmp_path / "cache" / "m").iterdir()) == []


@pytest.mark.parametrize("kind", ["closed", "trickling", "failing", "telling", "refusing"])
def test_no_error_and_no_line_of_the_log_tells_the_registrys_address_or_password(
    apart: Apart,
    tmp_path: Path,
    bundles: dict[str, Path],
    closed_place: str,
    caplog: pytest.LogCaptureFixture,
    kind: str,
) -> None:
    told = b'{"error_code": "%s", "message": "http://user:secret@127.0.0.1:1/x, see /srv/mlruns/1"}'
    with ExitStack() as stack, caplog.at_level(logging.DEBUG):
        place = closed_place
        if kind == "trickling":
            place = stack.enter_context(trickling())
        elif kind != "closed":
            status, code = {"failing": (500, b"INTERNAL_ERROR"), "telling": (404, b"OTHER")}.get(
                kind, (403, b"http://user:secret@127.0.0.1")
            )
            server = strange_server(status, told % code, probe_is_well=kind != "failing")
            place = stack.enter_context(server).removeprefix("http://")
        store = store_of(apart(place), tmp_path, bundles["shipped"])
        store.refresh()
        with pytest.raises(CspaceError) as caught:
            store.resolve(NAMED)
        clean(caught.value)
        assert store.versions(NAMED.name) == []
    assert "the registry does not answer" in caplog.text
    assert not [secret for secret in SECRETS if secret in caplog.text]


def resolve_anyway(store: ModelStore) -> None:
    with pytest.raises(CspaceError):
        store.resolve(NAMED)


def refuse(version: ModelVersion, folder: Path) -> Path:
    raise RegistryError("no")


def clean(error: BaseException | None) -> None:
    """Neither it nor whatever a traceback would show of its causes."""
    while error is not None:
        assert not [secret for secret in SECRETS if secret in str(error)], str(error)
        error = error.__cause__ or error.__context__
