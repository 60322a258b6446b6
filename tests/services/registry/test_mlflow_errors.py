"""No error of MLflow, requests, json or protobuf comes out of the adapters, whatever answers."""

import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mlflow.exceptions import MlflowException

from cspace.bundle import Bundle
from cspace.errors import (
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
    StorageError,
)
from services.registry.entities import ModelVersion
from services.registry.errors import mapped
from services.registry.models import ModelRegistry
from tests.bundles import write_tiny_bundle
from tests.services.registry.strange_server import strange_server

Operation = Callable[[ModelRegistry, Path], object]
VERSION = ModelVersion("m", 1, "r", "d" * 64, (), {}, 0)


def _register(registry: ModelRegistry, folder: Path) -> ModelVersion:
    made = folder / "bundle"
    bundle = Bundle.load(made if made.exists() else write_tiny_bundle(made))
    return registry.register("m", bundle.folder, "r" * 32, bundle.digest, {}, alias="challenger")


OPERATIONS: dict[str, Operation] = {
    "register": _register,
    "version": lambda registry, folder: registry.version("m", 1),
    "by_alias": lambda registry, folder: registry.by_alias("m", "champion"),
    "versions": lambda registry, folder: registry.versions("m"),
    "set_alias": lambda registry, folder: registry.set_alias("m", "champion", 1),
    "set_tags": lambda registry, folder: registry.set_tags("m", 1, {"a": "b"}),
    "download": lambda registry, folder: registry.download(VERSION, folder / "got"),
}
ANSWERS = {
    "a web page": (200, b"<html>hello</html>"),
    "a list": (200, b"[1, 2]"),
    "a web page that is not found": (404, b"<html>not here</html>"),
    "a refusal": (403, b"Invalid Host header"),
    "a wrong request": (400, b'{"error_code": "BAD_REQUEST", "message": "no"}'),
}
AWAY = {
    "its own failure": (500, b"oops"),
    "a gateway without a server": (502, b"<html>bad gateway</html>"),
    "a database that is away": (503, b'{"error_code": "TEMPORARILY_UNAVAILABLE", "message": "no database"}'),
}


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """The patience of MLflow's client, which is long, is not under test."""
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "5")


@pytest.fixture
def closed_uri() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def silent_uri() -> Iterator[str]:
    """Takes connections and never says a word."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


@pytest.mark.parametrize("answer", ANSWERS | AWAY)
def test_an_answer_after_the_probe_becomes_an_error_of_the_project_in_every_call(
    hasty: None, tmp_path: Path, answer: str
) -> None:
    status, body = (ANSWERS | AWAY)[answer]
    with strange_server(status, body, probe_is_well=True) as uri:
        for name, operation in OPERATIONS.items():
            with pytest.raises(RegistryError) as caught:
                operation(ModelRegistry(uri), tmp_path)
            assert isinstance(caught.value, RegistryUnavailableError) == (answer in AWAY), name


# The limit is the point: with the client's own patience each of these takes minutes.
@pytest.mark.timeout(20)
def test_a_stopped_server_is_unavailable_at_once(closed_uri: str, tmp_path: Path) -> None:
    for operation in OPERATIONS.values():
        with pytest.raises(RegistryUnavailableError, match="MLFLOW_TRACKING_URI"):
            operation(ModelRegistry(closed_uri), tmp_path)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("operation", ["register", "version", "download"])
def test_a_server_that_hangs_is_unavailable_when_the_patience_ends(
    silent_uri: str, tmp_path: Path, operation: str
) -> None:
    with pytest.raises(RegistryUnavailableError):
        OPERATIONS[operation](ModelRegistry(silent_uri, timeout_s=0.2), tmp_path)


def test_none_is_an_answer_only_in_a_lookup_and_errors_of_the_project_pass_unchanged() -> None:
    gone = MlflowException("gone", error_code=1000)
    gone.error_code = "RESOURCE_DOES_NOT_EXIST"
    with pytest.raises(ModelNotFoundError), mapped("looking up m/1", lookup=True):
        raise gone
    with pytest.raises(RegistryError) as caught, mapped("registering m"):
        raise gone
    assert not isinstance(caught.value, ModelNotFoundError)
    for ours in (StorageError("full"), TypeError("a fault of ours")):
        with pytest.raises(type(ours)) as passed, mapped("trying"):
            raise ours
        assert passed.value is ours
