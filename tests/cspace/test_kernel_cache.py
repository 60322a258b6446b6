"""Kernels that are compiled, kept and found again; each step is a process of its own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cspace.kernel_cache

NJIT = "from cspace.kernel_cache import njit\n\n@njit(cache=True)\n"
INNER = NJIT + "def inner(x):\n    return x + {number}\n"
OUTER = (
    NJIT + "def other(x):\n    return 5 * x\n\n"
    "from cspace.inner import inner\n"
    "def made(held):\n    @njit(cache=True)\n    def kernel(x):\n        return held(x)\n\n"
    "    return kernel\n\n"
    "outer, second = made(inner), made(other)\nassert second(3) == 15\n"
)
CALL = (
    "from cspace.outer import outer\nprint(outer(1), sum(outer.stats.cache_hits.values()))\n"
    "import pathlib, sys\nprint(len(list(pathlib.Path(sys.argv[1]).rglob('*.nbc'))))"
)


def call(folder: Path, kernels: Path, *before: str) -> list[int]:
    """What ``outer(1)`` is, how often it was found, and how many kernels are on the disk afterwards."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels), "PYTHONPATH": str(folder)}
    command = [sys.executable, "-P", "-c", "\n".join([*before, CALL]), str(kernels)]
    return [int(word) for word in subprocess.check_output(command, env=environment, text=True).split()]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A tree of the project with kernels of two files, one of which a factory makes of the other."""
    package = tmp_path / "cspace"
    package.mkdir()
    (package / "__init__.py").write_text("")
    shutil.copy(cspace.kernel_cache.__file__, package)
    (package / "inner.py").write_text(INNER.format(number=1))
    (package / "outer.py").write_text(OUTER)
    return tmp_path


@pytest.mark.slow
def test_a_kernel_is_found_again_until_one_that_it_calls_changes(folder: Path) -> None:
    kernels = folder / "kernels"
    assert call(folder, kernels) == [2, 0, 4]
    assert call(folder, kernels) == [2, 1, 4]
    (folder / "cspace/inner.py").write_text(INNER.format(number=20))
    assert call(folder, kernels)[:2] == [21, 0]


@pytest.mark.slow
def test_kernels_are_read_where_nothing_can_be_written_and_the_others_stay_in_memory(folder: Path) -> None:
    kernels = folder / "kernels"
    call(folder, kernels)
    # Root writes to folders that are read only, so no file can be made there in this process.
    refused = "import tempfile\ndef refuse(**_): raise OSError(30, 'Read-only file system')"
    refused += "\ntempfile.TemporaryFile = refuse"
    assert call(folder, kernels, refused) == [2, 1, 4]
    assert call(folder, folder / "none", refused)[:2] == [2, 0]
    blocked = folder / "a file"
    blocked.write_text("")
    assert call(folder, blocked) == [2, 0, 0]
