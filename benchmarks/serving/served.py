"""What the benchmarks of the API share: a server on one core, requests as bytes, pictures that are new."""

import http.client
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import ROOT
from cspace.simulator import Split
from cspace.worlds import default_world, simulator_of

BUNDLE = ROOT / "inference_api" / "pretrained"
SERVER_CORE, CLIENT_CORE = 0, 1


@dataclass(frozen=True)
class Served:
    """A running server.

    Args:
        port: on loopback.
        process_id: of its process.
    """

    port: int
    process_id: int

    @property
    def resident_kib(self) -> int:
        """Its resident memory."""
        lines = Path(f"/proc/{self.process_id}/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmRSS")).split()[1])


@contextmanager
def served(
    settings: Mapping[str, str] | None = None,
    core: int | None = SERVER_CORE,
    program: Sequence[str] = ("-m", "inference_api"),
    root: Path = ROOT,
) -> Iterator[Served]:
    """The API on one core, or on all for None; without a registry unless the settings name one.

    The program is what Python runs: the API, or a script that starts it with something added. The root is
    that of the checkout that it is taken from.
    """
    environment = {name: value for name, value in os.environ.items() if name != "MLFLOW_TRACKING_URI"}
    process = subprocess.Popen(
        [sys.executable, *program, "--port", "0"],
        cwd=root,
        env=environment
        | {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(root)}
        | dict(settings or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        preexec_fn=lambda: core is None or os.sched_setaffinity(0, {core}),  # noqa: PLW1509 - nothing else runs yet
    )
    try:
        address = process.stdout.readline().split()[2]
        yield Served(int(address.rsplit(":", 1)[1]), process.pid)
    finally:
        process.terminate()
        process.wait(30)


def new_pictures(count: int, seed: int = 99) -> list[bytes]:
    """So many PNG files, each of a scenario of its own."""
    simulator = simulator_of(default_world())
    return [simulator.picture_file(one) for one in simulator.scenes(Split.DEMO, seed, count)]


def form(png: bytes, samples: int) -> tuple[bytes, dict[str, str]]:
    """A multipart body with its headers."""
    edge = "edge-of-a-part"
    head = f'--{edge}\r\nContent-Disposition: form-data; name="n"\r\n\r\n{samples}\r\n'
    head += f'--{edge}\r\nContent-Disposition: form-data; name="image"; filename="scenario.png"\r\n'
    head += "Content-Type: image/png\r\n\r\n"
    body = head.encode() + png + f"\r\n--{edge}--\r\n".encode()
    return body, {"Content-Type": f"multipart/form-data; boundary={edge}"}


class Asker:
    """Asks over one kept connection."""

    def __init__(self, port: int, samples: int) -> None:
        self.connection, self.samples = http.client.HTTPConnection("127.0.0.1", port), samples
        self.connection.connect()

    def __call__(self, png: bytes, accept: str = "application/x-npy") -> http.client.HTTPResponse:
        """The answer, read to its end; an error for any other status than 200."""
        body, headers = form(png, self.samples)
        self.connection.request("POST", "/sample", body, headers | {"Accept": accept})
        answer = self.connection.getresponse()
        content = answer.read()
        if answer.status != 200:
            raise RuntimeError(content)
        return answer
