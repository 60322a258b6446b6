"""What one hostile client without a key can do: memory, health, another client's samples, attack by attack.

    python -m benchmarks.serving.attacks --seconds 10

Server, attacker and two clients are processes of their own. One client asks for 300 samples with a pause of
20 ms between two requests, the other asks every 20 ms whether the server is alive. Each attack runs between
two quiet stretches of the same length, whose 99th percentiles are the usual ones. Resident memory is the
server's with its children's, highest during the attack less what it was before. Before the first attack the
arm's model is asked once; by how much that raises the memory is printed.
"""

import http.client
import multiprocessing
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import ROOT, machine
from benchmarks.serving.attack_requests import ATTACKS, depth_pictures
from benchmarks.serving.served import Asker, Served, new_pictures, served
from services.evaluator.tables import markdown

SAMPLES, PAUSE_S, WARM_UP_S = 300, 0.02, 3.0
# What sharing the processors with an attacker costs by itself.
CONTROL = "a process that computes and sends nothing"
_BUSY = "import sys, time\nend = time.monotonic() + float(sys.argv[1])\nwhile time.monotonic() < end: pass"


def ask_samples(port: int, seconds: float, answers) -> None:
    """Milliseconds of each request; a refusal counts as 60 s."""
    asker, pictures, took = Asker(port, SAMPLES), new_pictures(50), []
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        began = time.perf_counter()
        try:
            asker(pictures[len(took) % len(pictures)])
            took.append(1e3 * (time.perf_counter() - began))
        except (RuntimeError, OSError, http.client.HTTPException):
            took.append(60e3)
            asker = Asker(port, SAMPLES)
        time.sleep(PAUSE_S)
    answers.put(took)


def ask_health(port: int, seconds: float, answers) -> None:
    """Milliseconds of each look at /health/live."""
    connection, took = http.client.HTTPConnection("127.0.0.1", port, timeout=60), []
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        began = time.perf_counter()
        connection.request("GET", "/health/live")
        connection.getresponse().read()
        took.append(1e3 * (time.perf_counter() - began))
        time.sleep(PAUSE_S)
    answers.put(took)


def resident_mib(api: Served) -> float:
    """Of the server and its children."""
    children = Path(f"/proc/{api.process_id}/task/{api.process_id}/children").read_text().split()
    pages = 0
    for process_id in (api.process_id, *children):
        try:
            pages += int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
        except OSError:
            continue
    return pages * os.sysconf("SC_PAGE_SIZE") / 1024**2


class Watch(threading.Thread):
    """The highest resident memory until it is told to stop."""

    def __init__(self, api: Served) -> None:
        super().__init__(daemon=True)
        self.api, self.most, self.over = api, resident_mib(api), threading.Event()

    def run(self) -> None:
        while not self.over.wait(0.02):
            self.most = max(self.most, resident_mib(self.api))


def stretch(api: Served, seconds: float, attack: str | None = None) -> tuple[list[float], list[float], float]:
    """Milliseconds for samples and for health, and by how much the memory rose, MiB."""
    before, watch = resident_mib(api), Watch(api)
    watch.start()
    attacker = None
    if attack is not None:
        sent = ["-m", "benchmarks.serving.attack_requests", attack, str(api.port)]
        program = ["-c", _BUSY] if attack == CONTROL else sent
        attacker = subprocess.Popen([sys.executable, *program, str(seconds + 60)], cwd=ROOT)
        # Python and the first bodies take some seconds to come up.
        time.sleep(3)
    context = multiprocessing.get_context("spawn")
    queues = [context.Queue(), context.Queue()]
    clients = [
        context.Process(target=target, args=(api.port, seconds, queue))
        for target, queue in zip((ask_samples, ask_health), queues, strict=True)
    ]
    for client in clients:
        client.start()
    samples, health = (queue.get(timeout=seconds + 120) for queue in queues)
    for client in clients:
        client.join()
    if attacker is not None:
        # Not before: on a busy machine clients take as long to come up as an attack would last.
        attacker.terminate()
        attacker.wait(60)
    watch.over.set()
    watch.join()
    return samples, health, watch.most - before


def use_arm(api: Served) -> float:
    """Ask for one sample of the arm; by how much the memory rose, MiB."""
    before = resident_mib(api)
    with socket.create_connection(("127.0.0.1", api.port), timeout=120) as link:
        link.sendall(depth_pictures("/sample", n="1")(0))
        link.recv(1 << 16)
    return resident_mib(api) - before


def p99(took: list[float]) -> float:
    return float(np.quantile(took, 0.99))


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of a stretch (default: %(default)s)")
    parser.add_argument(
        "--only", action="append", choices=(CONTROL, *ATTACKS), help="these attacks; all when absent"
    )
    parser.add_argument("--registry", metavar="URI", help="MLflow that the server follows; none when absent")
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout whose server is attacked")
    options = parser.parse_args()
    table = [["attack", "memory, MiB", "health, ms", "usual p99, ms", "p99, ms", "ratio", "refused"]]
    settings = {"MLFLOW_TRACKING_URI": options.registry} if options.registry else {}
    with served(settings, core=None, root=options.root) as api:
        stretch(api, WARM_UP_S)
        first_mib = use_arm(api)
        usual = p99(stretch(api, options.seconds)[0])
        for attack in options.only or (CONTROL, *ATTACKS):
            samples, health, grown = stretch(api, options.seconds, attack)
            after = p99(stretch(api, options.seconds)[0])
            calm, usual = (usual + after) / 2, after
            refused = sum(one >= 60e3 for one in samples)
            table.append(
                [attack, f"{grown:+.0f}", f"{max(health):.0f}", f"{calm:.1f}", f"{p99(samples):.1f}",
                 f"{p99(samples) / calm:.2f}", str(refused)]
            )  # fmt: skip
            print(" | ".join(table[-1]), flush=True)
    print(f"\n{machine()}\n\n{markdown(table)}\n\nmemory: rise; health: longest answer of /health/live")
    print(f"the arm's first request: {first_mib:+.0f} MiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
