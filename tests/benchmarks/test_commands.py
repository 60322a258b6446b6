"""Every benchmark starts by the command that its documentation gives, from the project's folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
COMMANDS = sorted(
    path.relative_to(ROOT)
    for path in (ROOT / "benchmarks").rglob("*.py")
    if '__name__ == "__main__"' in path.read_text(encoding="utf-8") and path.name != "__main__.py"
)


@pytest.mark.slow
@pytest.mark.parametrize("path", COMMANDS, ids=str)
def test_a_benchmark_starts_by_its_documented_command(path):
    module = ".".join(path.with_suffix("").parts)
    assert f"python -m {module}" in (ROOT / path).read_text(encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [sys.executable, "-m", module, "--help"]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
