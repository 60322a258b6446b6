"""What a benchmark ran on."""

import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import httpx

from services.local.stack import free_ports

ROOT = Path(__file__).resolve().parents[1]


def machine() -> dict[str, str]:
    """Processor, cores, memory, Python, date and commit."""
    commit = _git("rev-parse", "--short", "HEAD")
    return {
        "processor": _field(Path("/proc/cpuinfo"), "model name") or platform.processor(),
        "cores": str(len(_lines(Path("/proc/cpuinfo"), "processor"))),
        "memory": _field(Path("/proc/meminfo"), "MemTotal"),
        "python": platform.python_version(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": commit + ("+" if _git("status", "--porcelain", "--untracked-files=no") else ""),
    }


@contextmanager
def served(root: Path, core: int | None = None) -> Iterator[tuple[int, int]]:
    """Port and process of a checkout's API with the shipped models alone; on one core if named."""
    environment = {name: value for name, value in os.environ.items() if name != "MLFLOW_TRACKING_URI"}
    environment |= {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(root)}
    (port,) = free_ports(1)
    command = [] if core is None else ["taskset", "--cpu-list", str(core)]
    command += [sys.executable, "-m", "inference_api", "--port", str(port)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=root, env=environment, **quiet) as process:
        try:
            while not _is_ready(port):
                time.sleep(0.2)
            yield port, process.pid
        finally:
            process.terminate()


def _is_ready(port: int) -> bool:
    with suppress(httpx.TransportError):
        return httpx.get(f"http://127.0.0.1:{port}/health/ready", timeout=60).status_code == 200
    return False


def resident_mib(process: int, what: str) -> float:
    """``VmRSS``, what a process holds, or ``VmHWM``, the most that it has held."""
    return int(_field(Path(f"/proc/{process}/status"), what).split()[0]) / 1024


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)  # noqa: S607
    return done.stdout.strip()


def _field(path: Path, name: str) -> str:
    found = _lines(path, name)
    return found[0].split(":", 1)[1].strip() if found else "unknown"


def _lines(path: Path, name: str) -> list[str]:
    return [line for line in path.read_text().splitlines() if line.split(":")[0].strip() == name]
