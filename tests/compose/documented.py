"""Commands as docs/containers.md gives them, for a stack of the tests."""

from pathlib import Path

from tests.compose.stack import Stack
from tests.docs.blocks import ROOT, blocks
from tests.docs.shell import run_block

LIMIT_S = 600.0


def run_documented(stack: Stack, command: str, folder: Path) -> str:
    """Run the one block that uses a command, with ``folder`` as ``$BACKUP``; what it printed.

    Raises AssertionError with all output when the block fails.
    """
    (block,) = (found for found in blocks(ROOT / "docs" / "containers.md") if command in found.source)
    return run_block(block, folder, {**stack.environment, "BACKUP": str(folder)}, {}, LIMIT_S)
