"""What a benchmark ran on."""

import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

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


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)  # noqa: S607
    return done.stdout.strip()


def _field(path: Path, name: str) -> str:
    found = _lines(path, name)
    return found[0].split(":", 1)[1].strip() if found else "unknown"


def _lines(path: Path, name: str) -> list[str]:
    return [line for line in path.read_text().splitlines() if line.split(":")[0].strip() == name]
