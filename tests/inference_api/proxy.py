"""The documented nginx before an API, as a process of the test's own on unprivileged loopback ports."""

import shutil
import socket
import ssl
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx

from tests.inference_api.raw import PATIENCE_S, until
from tests.inference_api.server import ROOT

NAME = "api.example"
TEMPORARY = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")


@dataclass(frozen=True)
class Proxy:
    """nginx that runs.

    Args:
        port: on 127.0.0.1.
        trust: of its certificate.
    """

    port: int
    trust: ssl.SSLContext

    def client(self, source: str = "127.0.0.1") -> httpx.Client:
        """A client that asks for the documented name, from a loopback address."""
        transport = httpx.HTTPTransport(verify=self.trust, local_address=source)
        return httpx.Client(
            transport=transport,
            base_url=f"https://127.0.0.1:{self.port}",
            headers={"host": NAME},
            timeout=PATIENCE_S,
        )

    def ask(self, client: httpx.Client, method: str, path: str, **options: object) -> httpx.Response:
        """A request with the name in the handshake too."""
        request = client.build_request(method, path, **options)  # type: ignore[arg-type]
        request.extensions["sni_hostname"] = NAME
        return client.send(request)

    def connect(self, name: str = NAME) -> ssl.SSLSocket:
        """A connection of the test's own making."""
        plain = socket.create_connection(("127.0.0.1", self.port), PATIENCE_S)
        try:
            return self.trust.wrap_socket(plain, server_hostname=name)
        except BaseException:
            plain.close()
            raise


def program(name: str) -> str:
    """The path of a program that the test needs."""
    found = shutil.which(name, path="/usr/sbin:/usr/local/sbin:/usr/bin:/bin:/usr/local/bin")
    assert found, f"{name} is not installed: apt-get install nginx-light openssl"
    return found


@contextmanager
def nginx_before(api: str, folder: Path) -> Iterator[Proxy]:
    """Run docker/nginx/tls.conf before an API.

    Args:
        api: its address.
        folder: for certificate, configuration and temporary files.
    """
    port = _free_port()
    _certificate(folder)
    temporary = "".join(f"  {kind}_temp_path {kind};\n" for kind in TEMPORARY)
    own = {
        "http {\n": f"http {{\n  access_log off;\n{temporary}",
        "worker_processes auto;": "worker_processes 1; pid nginx.pid;",
        "listen 443 ": f"listen 127.0.0.1:{port} ",
        "server 127.0.0.1:8000;": f"server {urlsplit(api).netloc};",
        "/etc/ssl/certs/api.example.pem": str(folder / "certificate.pem"),
        "/etc/ssl/private/api.example.key": str(folder / "key.pem"),
    }
    with _nginx("tls.conf", folder, port, own):
        trust = ssl.create_default_context(cafile=str(folder / "certificate.pem"))
        yield Proxy(port, trust)


@contextmanager
def nginx_of_the_stack(file: str, upstream: tuple[str, str], folder: Path) -> Iterator[str]:
    """Run one of the two proxies of docker-compose.yml; its address.

    Args:
        file: in docker/nginx.
        upstream: the address that it passes on to in the stack, and the one here.
        folder: for configuration and temporary files.
    """
    port = _free_port()
    listens = {"edge.conf": "listen 8080;", "mlflow-reader.conf": "listen 5000;"}[file]
    own = {listens: f"listen 127.0.0.1:{port};", upstream[0]: upstream[1], "/tmp/": f"{folder}/"}  # noqa: S108
    with _nginx(file, folder, port, own):
        yield f"http://127.0.0.1:{port}"


@contextmanager
def _nginx(file: str, folder: Path, port: int, own: Mapping[str, str]) -> Iterator[None]:
    """Run a documented file with what a test needs otherwise, until the block ends."""
    for path in (ROOT / "docker" / "nginx").iterdir():
        text = path.read_text(encoding="utf-8")
        if path.name == file:
            for documented, replaced in own.items():
                assert documented in text
                text = text.replace(documented, replaced)
        (folder / path.name).write_text(text, encoding="utf-8")
    command = [program("nginx"), "-p", str(folder), "-c", file, "-e", "stderr", "-g", "daemon off;"]
    log = folder / "nginx.log"
    with log.open("wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out)
    try:
        until(lambda: process.poll() is not None or _listens(port))
        assert process.poll() is None, log.read_text()
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


def _certificate(folder: Path) -> None:
    made = ("-keyout", str(folder / "key.pem"), "-out", str(folder / "certificate.pem"))
    subject = ("-subj", f"/CN={NAME}", "-addext", f"subjectAltName=DNS:{NAME}")
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    command = [program("openssl"), "req", "-x509", *curve, *made, *subject]
    subprocess.run(command, check=True, capture_output=True)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def _listens(port: int) -> bool:
    with socket.socket() as link:
        return link.connect_ex(("127.0.0.1", port)) == 0
