"""Shell blocks as users run them: from the project's root, with this interpreter first on the path."""

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.docs.blocks import ROOT, Block

BASH = "/bin/bash"


def run_block(
    block: Block,
    folder: Path,
    environment: Mapping[str, str],
    replaced: Mapping[str, str],
    limit_s: float,
    where: Path = ROOT,
) -> str:
    """Run a block's commands in one shell that stops at the first failure; everything that it printed.

    Args:
        block: what is run.
        folder: becomes the home folder.
        environment: beside the usual one.
        replaced: texts of the block, such as addresses, with what stands for them in the test.
        limit_s: time for all commands together.
        where: the working folder.
    """
    source = substitute(block.source, replaced)
    outcome = subprocess.run(
        [BASH, "-euo", "pipefail", "-c", source],
        cwd=where,
        env=shell_environment(folder) | dict(environment),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=limit_s,
    )
    assert outcome.returncode == 0, (
        f"{block.name} ended with {outcome.returncode}\n{source}\n{outcome.stdout}"
    )
    return outcome.stdout


def linked_root(folder: Path) -> Path:
    """A folder that looks like the project's root; what a block writes into it stays out of the project."""
    root = folder / "root"
    root.mkdir()
    for entry in ROOT.iterdir():
        # What a block builds is its own, and never there already.
        if entry.name != "build":
            (root / entry.name).symlink_to(entry)
    return root


def substitute(source: str, replaced: Mapping[str, str]) -> str:
    """All texts replaced at once, so that none meets another's result; this environment for ``.venv``."""
    table = {".venv/bin/": f"{Path(sys.executable).parent}/", **replaced}
    return re.sub("|".join(map(re.escape, table)), lambda found: table[found[0]], source)


def shell_environment(folder: Path) -> dict[str, str]:
    """A user's environment without the caller's own settings of the project."""
    foreign = ("CSPACE_", "MLFLOW_", "RAY_", "PYTEST_")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(foreign)}
    path = os.pathsep.join([str(Path(sys.executable).parent), kept.get("PATH", os.defpath)])
    return kept | {"HOME": str(folder), "PATH": path, "PYTHONPATH": str(ROOT)}
