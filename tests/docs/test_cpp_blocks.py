"""The C++ of the documents: compiled as the page says, without a warning, and run against a real API."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.docs.blocks import ROOT, Block, Kind, all_blocks
from tests.docs.shell import linked_root, run_block
from tests.docs.tiny_api import DOCUMENTED, TinyApi

PAGE = ROOT / "docs" / "integrations.md"
LIMIT_S = 100.0
COMPILER = shutil.which("g++")


def has_libcurl() -> bool:
    if COMPILER is None:
        return False
    process = subprocess.run(
        [COMPILER, "-E", "-x", "c++", "-"],
        input="#include <curl/curl.h>\n",
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    return process.returncode == 0


needs_libcurl = pytest.mark.skipif(not has_libcurl(), reason="no g++ with libcurl's headers on this machine")


def commands() -> Block:
    return next(block for block in all_blocks(Kind.ELSEWHERE) if block.document == PAGE)


@pytest.fixture
def root(tmp_path: Path, tiny_api: TinyApi) -> Path:
    """Like the project's root, with the page's program in it, which asks the tiny API."""
    program = next(block for block in all_blocks(Kind.CPP) if block.document == PAGE)
    assert program.source.startswith("// sampler.cpp")
    assert DOCUMENTED in program.source
    folder = linked_root(tmp_path)
    (folder / "sampler.cpp").write_text(
        program.source.replace(DOCUMENTED, tiny_api.address(program.document))
    )
    return folder


def test_every_cpp_block_stands_on_the_page_that_this_file_runs() -> None:
    assert [block.document for block in all_blocks(Kind.CPP)] == [PAGE]


@needs_libcurl
def test_the_program_compiles_without_a_warning_and_prints_the_samples(root: Path, tmp_path: Path) -> None:
    block = commands()
    assert "g++ -std=c++17 -O2 -Wall -Wextra -o sampler sampler.cpp -lcurl" in block.source
    assert "./sampler docs/images/scenario.png 300 7" in block.source
    printed = run_block(block, tmp_path, {}, {"-Wextra": "-Wextra -Werror"}, LIMIT_S, root)
    samples = np.array([[float(angle) for angle in line.split()] for line in printed.splitlines()])
    assert samples.shape == (300, 2)
    assert np.abs(samples).max() <= np.pi
    assert len(np.unique(samples, axis=0)) > 200


@needs_libcurl
def test_the_program_ends_with_the_reason_that_the_server_gives(root: Path, tmp_path: Path) -> None:
    run_block(commands(), tmp_path, {}, {}, LIMIT_S, root)
    outcome = subprocess.run(
        ["./sampler", "docs/images/scenario.png", "0", "7"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert (outcome.returncode, outcome.stdout) == (1, "")
    assert outcome.stderr.startswith("422: ")
    assert "urn:cspace-sampler:problem:invalid-value" in outcome.stderr
