"""How much memory a server takes under the mix of requests that costs most.

    python -m benchmarks.serving.memory --seconds 120

Twenty clients, each with an address of its own, ask at the same time for what is dear: new depth pictures of
all sizes, as files and as tensors, 20,000 samples or confidences, plans of 10 s for the arm and in the plane,
large flat pictures, and bodies that are no request; a tenth of them is left at once. The memory of the server
and its children is read from ``/proc`` ten times a second: resident, and of that what is in no mapped file
and cannot be taken back.
"""

import http.client
import json
import struct
import sys
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.attack_requests import chunk, png
from benchmarks.serving.served import Served, served
from cspace.png import encode_png

CLIENTS = 20
ARM = "pretrained-panda"
REST = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
POSE = [
    [-0.7071, -0.3714, -0.6018, 1.3],
    [-0.7071, 0.3714, 0.6018, -0.8],
    [0.0, 0.8510, -0.5252, 1.0],
    [0, 0, 0, 1],
]
Ask = tuple[str, dict[str, str], bytes]


def form(files: list[bytes], fields: list[tuple[str, object]]) -> tuple[dict[str, str], bytes]:
    """Headers and body: pictures, then fields, those of bytes as files."""
    body = b""
    for name, value in [*(("image", one) for one in files), *fields]:
        of_file = '; filename="a"' if isinstance(value, bytes) else ""
        body += f'--B\r\nContent-Disposition: form-data; name="{name}"{of_file}\r\n\r\n'.encode()
        body += (value if isinstance(value, bytes) else str(value).encode()) + b"\r\n"
    return {"Content-Type": "multipart/form-data; boundary=B"}, body + b"--B--\r\n"


def depth(side: int, rng: np.random.Generator, *, rough: bool) -> bytes:
    """A PNG of 16 bits: a plane with boxes before it, or noise."""
    rows = np.full((side, side), 1800, dtype=">u2")
    if rough:
        rows[:] = rng.integers(300, 2500, rows.shape)
    for _ in range(6):
        x, y = rng.integers(0, side, 2)
        rows[y : y + side // 5, x : x + side // 5] = rng.integers(500, 1700)
    data = b"".join(b"\0" + row.tobytes() for row in rows)
    head = struct.pack(">IIBBBBB", side, side, 16, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(data, 1))
        + chunk(b"IEND", b"")
    )


@cache
def pool(side: int, number: int, *, rough: bool) -> bytes:
    return depth(side, np.random.default_rng(number), rough=rough)


def camera(side: int, rng: np.random.Generator, focal: float = 0.7) -> str:
    centre = side / 2 + rng.random()
    return json.dumps({"fx": focal * side, "fy": focal * side, "cx": centre, "cy": centre, "pose": POSE})


def seen(rng: np.random.Generator, side: int, count: int, *, rough: bool = False) -> tuple[list[bytes], list]:
    """Pictures with cameras that no server has seen, and so new to it, with their fields."""
    pictures = [pool(side, int(rng.integers(4)), rough=rough) for _ in range(count)]
    return pictures, [("model", ARM), *(("camera", camera(side, rng)) for _ in pictures)]


def pictures(rng: np.random.Generator) -> Ask:
    side, count = ((160, 4), (640, 4), (1024, 2), (2048, 1))[rng.integers(4)]
    files, fields = seen(rng, side, count, rough=side == 160)
    return ("/sample", *form(files, [*fields, ("n", 1), ("min_confidence", 0)]))


def many_samples(rng: np.random.Generator) -> Ask:
    files, fields = seen(rng, 160, 1)
    return ("/sample", *form(files, [*fields, ("n", 20000), ("min_confidence", rng.choice([0.0, 1.0]))]))


def flat_samples(rng: np.random.Generator) -> Ask:
    return ("/sample", *form([flat_picture(int(rng.integers(6)))], [("n", 20000)]))


@cache
def flat_picture(seed: int) -> bytes:
    return png(2048, 6, seed=seed)


def confidences(rng: np.random.Generator) -> Ask:
    files, fields = seen(rng, 160, 1)
    rows = BytesIO()
    np.save(rows, np.array(REST) + rng.uniform(-0.1, 0.1, (20000, 7)))
    return ("/validity", *form(files, [*fields, ("configurations", rows.getvalue())]))


def arm_plan(rng: np.random.Generator, ways: int = 64, limit_s: float = 10) -> Ask:
    files, fields = seen(rng, 160, 1)
    goal = (np.array(REST) + rng.uniform(-0.9, 0.9, 7)).clip(-2.6, 2.6)
    goal[3] = min(goal[3], -0.2)
    goal[5] = max(goal[5], 0.1)
    query_fields = [
        ("start", json.dumps(REST)),
        ("goal", json.dumps(goal.tolist())),
        ("ways", ways),
        ("time_limit_s", limit_s),
    ]
    return ("/plan", *form(files, [*fields, *query_fields, ("alternatives", "true"), ("next_view", "true")]))


def flat_plan(rng: np.random.Generator) -> Ask:
    picture = encode_png(rng.integers(0, 256, (48, 48, 3), dtype=np.uint8))
    ends = [("start", "[1.5, 0.5]"), ("goal", "[-1.5, 0.5]"), ("ways", 64), ("time_limit_s", 10)]
    return ("/plan", *form([picture], [*ends, ("alternatives", "true")]))


def noise(_: np.random.Generator) -> Ask:
    return ("/sample", {"Content-Type": "application/json"}, b"[" + b"[]," * 2_000_000 + b"1]")


def tensors(rng: np.random.Generator) -> Ask:
    """Depth pictures by the Open Inference Protocol, as bytes behind the JSON object."""
    side = 1024
    depths = rng.integers(800, 1800, (2, side, side)).astype("<u2")
    lens = np.array([[0.7 * side, 0.7 * side, side / 2 + rng.random(), side / 2]] * 2)
    inputs = (
        ("depth", "UINT16", depths),
        ("intrinsics", "FP64", lens),
        ("poses", "FP64", np.array([POSE] * 2)),
    )
    described = [
        {
            "name": name,
            "datatype": kind,
            "shape": array.shape,
            "parameters": {"binary_data_size": array.nbytes},
        }
        for name, kind, array in inputs
    ]
    head = json.dumps({"inputs": described, "parameters": {"n": 1, "min_confidence": 0}}).encode()
    headers = {"Inference-Header-Content-Length": str(len(head))}
    return f"/v2/models/{ARM}/infer", headers, head + b"".join(array.tobytes() for *_, array in inputs)


KINDS: dict[str, Callable[[np.random.Generator], Ask]] = {
    "depth pictures": pictures,
    "depth pictures as tensors": tensors,
    "samples of the arm": many_samples,
    "samples of flat pictures": flat_samples,
    "confidences": confidences,
    "plans of the arm": arm_plan,
    "flat plans": flat_plan,
    "bodies that are no request": noise,
}


def ask(port: int, number: int, kinds: list[str], until: float, answers: Counter[tuple[str, str]]) -> None:
    """One client: one request after the other, now and then one that it leaves."""
    rng, turn = np.random.default_rng(number), number
    while time.monotonic() < until:
        kind = kinds[turn % len(kinds)]
        turn += 1
        path, headers, body = KINDS[kind](rng)
        link = http.client.HTTPConnection(
            "127.0.0.1", port, timeout=120, source_address=(f"127.0.4.{number + 1}", 0)
        )
        outcome = "no answer"
        with suppress(OSError, http.client.HTTPException):
            link.request("POST", path, body, headers)
            if rng.random() < 0.1:
                time.sleep(0.05)
                outcome = "left"
            else:
                answer = link.getresponse()
                answer.read()
                outcome = str(answer.status)
        answers[kind, outcome] += 1
        link.close()


def processes(api: Served) -> Iterator[int]:
    """Numbers of the server's process and of all below it."""
    found = [api.process_id]
    while found:
        one = found.pop()
        yield one
        with suppress(OSError):
            for children in Path(f"/proc/{one}/task").glob("*/children"):
                found += [int(child) for child in children.read_text().split()]


def memory_mib(api: Served) -> tuple[float, float]:
    """Resident, and of that what is no file."""
    total = {"VmRSS": 0, "RssAnon": 0, "RssShmem": 0}
    for process_id in processes(api):
        with suppress(OSError):
            for line in Path(f"/proc/{process_id}/status").read_text().splitlines():
                name, _, value = line.partition(":")
                if name in total:
                    total[name] += int(value.split()[0])
    return total["VmRSS"] / 1024, (total["RssAnon"] + total["RssShmem"]) / 1024


def memory_text(mib: tuple[float, float]) -> str:
    return f"{mib[0]:.0f} MiB, {mib[1]:.0f} without files"


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="of the load (default: %(default)s)")
    parser.add_argument(
        "--only", action="append", choices=tuple(KINDS), help="these requests; all when absent"
    )
    parser.add_argument(
        "--clients", type=int, default=CLIENTS, help="at the same time (default: %(default)s)"
    )
    parser.add_argument("--registry", help="address of an MLflow server: its processes count, too")
    parser.add_argument(
        "--threads", type=int, help="CSPACE_API_THREADS (default: as many as there are cores)"
    )
    options = parser.parse_args()
    settings = {"MLFLOW_TRACKING_URI": options.registry} if options.registry else {}
    if options.threads:
        settings["CSPACE_API_THREADS"] = str(options.threads)
    answers: Counter[tuple[str, str]] = Counter()
    with served(settings, core=None) as api:
        time.sleep(5.0)
        print(f"at rest: {memory_text(memory_mib(api))}", flush=True)
        until = time.monotonic() + options.seconds
        kinds = options.only or list(KINDS)
        clients = [
            threading.Thread(target=ask, args=(api.port, number, kinds, until, answers), daemon=True)
            for number in range(options.clients)
        ]
        for client in clients:
            client.start()
        most = (0.0, 0.0)
        began, last = time.monotonic(), 0.0
        while time.monotonic() < until or any(client.is_alive() for client in clients):
            now = memory_mib(api)
            most = max(most[0], now[0]), max(most[1], now[1])
            if time.monotonic() - last > options.seconds / 12:
                last = time.monotonic()
                print(f"{last - began:4.0f} s: {memory_text(now)}", flush=True)
            time.sleep(0.1)
        time.sleep(5.0)
        print(f"most: {memory_text(most)}")
        print(f"afterwards: {memory_text(memory_mib(api))}")
    print(machine())
    for (kind, outcome), count in sorted(answers.items()):
        print(f"{kind}: {count} x {outcome}")
    return 1 if any(outcome.startswith("5") and outcome != "503" for _, outcome in answers) else 0


if __name__ == "__main__":
    sys.exit(main())
