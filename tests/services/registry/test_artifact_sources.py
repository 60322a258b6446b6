"""A registry names where a bundle lies; it is fetched from the artifact store and from nowhere else."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from cspace.errors import RegistryError
from services.registry.entities import ModelVersion
from services.registry.models import ModelRegistry, check_source

VERSION = ModelVersion("m", 1, "r", "d" * 64, (), {}, 0)
SERVER = "http://user:secret@registry:5000"


class Registry:
    """Names any source, and leads requests for artifacts to another server."""

    def __init__(self) -> None:
        self.source, self.paths = "", list[str]()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.paths.append(self.path)
                if "mlflow-artifacts" in self.path:
                    self.send_response(302)
                    self.send_header("Location", f"{outer.address}/elsewhere")
                    body = b""
                else:
                    self.send_response(200)
                    body = json.dumps({"artifact_uri": outer.source, "files": []}).encode()
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:  # noqa: A002
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01}).start()

    def end(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def registry() -> Iterator[Registry]:
    found = Registry()
    yield found
    found.end()


@pytest.mark.parametrize("form", ["file://{folder}", "{folder}", "{address}/x", "ftp://127.0.0.1:1/x"])
def test_a_bundle_is_fetched_from_no_place_of_the_registrys_choice(
    registry: Registry, tmp_path: Path, form: str
) -> None:
    own = tmp_path / "own" / "artifacts" / "bundle"
    own.mkdir(parents=True)
    (own / "secret").write_text("of this machine")
    registry.source = form.format(folder=tmp_path / "own", address=registry.address)
    with pytest.raises(RegistryError, match="artifact store"):
        ModelRegistry(registry.address).download(VERSION, tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()
    assert "elsewhere" not in "".join(registry.paths)
    assert "/x" not in registry.paths


def test_a_redirect_of_the_artifact_store_is_not_followed(registry: Registry, tmp_path: Path) -> None:
    registry.source = "mlflow-artifacts:/1/models/m"
    with pytest.raises(RegistryError):
        ModelRegistry(registry.address).download(VERSION, tmp_path / "bundle")
    assert any("mlflow-artifacts" in path for path in registry.paths)
    assert "/elsewhere" not in registry.paths


@pytest.mark.parametrize(
    ("source", "uri", "store"),
    [
        ("mlflow-artifacts:/1/models/m", SERVER, ""),
        ("mlflow-artifacts://registry:5000/1/models/m", SERVER, ""),
        ("s3://models/1/m", SERVER, "s3://models"),
        ("file:///state/artifacts/m", "sqlite:///state/mlflow.db", ""),
        ("/state/artifacts/m", "sqlite:///state/mlflow.db", ""),
    ],
)
def test_the_artifact_store_is_where_bundles_are_fetched(source: str, uri: str, store: str) -> None:
    check_source("m/1", source, uri, store)


@pytest.mark.parametrize(
    ("source", "store"),
    [
        ("mlflow-artifacts://elsewhere:5000/1/m", ""),
        ("mlflow-artifacts://registry:5001/1/m", ""),
        ("mlflow-artifacts://registry:5000@elsewhere/1/m", ""),
        ("mlflow-artifacts:/1/../../api/2.0/mlflow/x", ""),
        ("mlflow-artifacts:/1/%2e%2e/%2e%2e/x", ""),
        ("mlflow-artifacts:/1/%252e%252e/x", ""),
        ("mlflow-artifacts:/1/100%/x", ""),
        ("models:/m/1", ""),
        ("runs:/r/model", ""),
        ("s3://models/1/m", ""),
        ("s3://models-of-others/1/m", "s3://models"),
        ("s3://models/../others", "s3://models"),
        ("file:///etc", "s3://models"),
        ("", ""),
    ],
)
def test_any_other_place_is_refused_and_told_without_a_password(source: str, store: str) -> None:
    with pytest.raises(RegistryError, match="artifact store") as caught:
        check_source("m/1", source, SERVER, store)
    assert "secret" not in str(caught.value)
    assert "CSPACE_ARTIFACT_STORE" in (caught.value.remedy or "")
