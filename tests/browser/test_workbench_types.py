"""The types in the comments of the workbench's modules, where TypeScript's compiler is installed."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TSC = shutil.which("tsc")
pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.mark.skipif(TSC is None, reason="TypeScript's compiler is not installed")
def test_the_types_of_the_page_hold() -> None:
    command = [str(TSC), "-p", "inference_api/workbench/jsconfig.json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
