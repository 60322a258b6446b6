"""The types in the comments of the workbench's modules, where TypeScript's compiler is on the path."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# npx --package typescript@5 tsc -p inference_api/workbench/jsconfig.json
CONFIG = "inference_api/workbench/jsconfig.json"

pytestmark = [pytest.mark.browser, pytest.mark.slow]


TSC = shutil.which("tsc")


@pytest.mark.skipif(TSC is None, reason="TypeScript's compiler is not installed")
def test_the_types_of_the_page_hold() -> None:
    done = subprocess.run([str(TSC), "-p", CONFIG], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
