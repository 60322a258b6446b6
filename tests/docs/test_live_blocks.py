"""The shell blocks that need all services, document by document in order, as a reader would run them."""

from collections.abc import Iterator

import pytest

from tests.docs.blocks import ROOT, Block, Kind, all_blocks
from tests.docs.live_stack import LiveStack, live_stack
from tests.docs.shell import run_block

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(1200)]

# Every stage of a job runs, in seconds instead of minutes.
SHORTER = {
    "--preset quickstart": "--preset smoke",
    "submit training/cluster_train.py": "submit -- training/cluster_train.py --preset smoke",
    "-m services.evaluator --model": "-m services.evaluator --scenarios 2 --model",
}
# Files that blocks write into the working folder, which must stay the project itself: Ray uploads it.
WRITTEN = ("runs.csv", "plan.png", "build/path-sampler", "build/comparison")
LIMIT_S = 600.0
# README trains the version that it evaluates and samples, so its blocks come first.
BLOCKS = sorted(all_blocks(Kind.STACK), key=lambda block: block.document != ROOT / "README.md")


@pytest.fixture(scope="module")
def stack() -> Iterator[LiveStack]:
    with live_stack() as running:
        yield running


@pytest.fixture(scope="module")
def session_lines() -> str:
    """The block that sets a shell up, which every other block of a session needs."""
    return next(block.source for block in BLOCKS if "services.local env" in block.source)


@pytest.mark.parametrize(
    "block",
    [
        pytest.param(block, marks=[pytest.mark.slow] * (block.rest == "slow"), id=block.name)
        for block in BLOCKS
    ],
)
def test_a_block_runs_against_all_services(block: Block, stack: LiveStack, session_lines: str) -> None:
    shell = Block(block.document, block.line, block.language, session_lines + block.source, block.mark, "")
    written = {name: str(stack.folder / name) for name in WRITTEN}
    run_block(shell, stack.folder, stack.settings, {**stack.replaced, **SHORTER, **written}, LIMIT_S)
