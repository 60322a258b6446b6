"""Shell blocks that need no services of the stack."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.docs.blocks import ROOT, Block, Kind, all_blocks
from tests.docs.shell import linked_root, run_block, substitute
from tests.docs.tiny_api import DOCUMENTED, TinyApi

LIMIT_S = 100.0
MAKE = shutil.which("make") or "make"


@pytest.mark.parametrize(
    "block",
    [
        pytest.param(block, marks=[pytest.mark.slow] * (block.rest == "slow"), id=block.name)
        for block in all_blocks(Kind.STATIC)
    ],
)
def test_a_static_block_runs_as_it_stands(block: Block, tmp_path: Path) -> None:
    assert run_block(block, tmp_path, {}, {}, LIMIT_S, linked_root(tmp_path))


@pytest.mark.parametrize("block", all_blocks(Kind.API), ids=lambda block: block.name)
def test_a_block_runs_against_an_inference_api(block: Block, tmp_path: Path, tiny_api: TinyApi) -> None:
    replaced = {DOCUMENTED: tiny_api.address(block.document)}
    assert run_block(block, tmp_path, {}, replaced, LIMIT_S, linked_root(tmp_path))


@pytest.mark.parametrize("block", all_blocks(Kind.MAKE), ids=lambda block: block.name)
def test_every_target_that_a_block_names_is_in_the_makefile(block: Block) -> None:
    for command in block.commands:
        program, *arguments = command.partition(" #")[0].split()
        assert program == "make"
        outcome = subprocess.run(
            [MAKE, "--dry-run", *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert outcome.returncode == 0, f"{command}\n{outcome.stderr}"


def test_texts_are_replaced_at_once() -> None:
    assert substitute("a b", {"a": "b", "b": "a"}) == "b a"
