"""The planner's own command, run as a user would: problems that nobody was trained on, samples over HTTP."""

import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from cspace.errors import PlanningError
from services.local.quickstart.tours import Tour

PLANNING_SEED = 7
PLANNING_LIMIT_S = 120.0
# What the command ends with when the planner found no path: an outcome, which it has printed and drawn.
NOT_SOLVED = 1


def plan_and_draw(
    url: str,
    root: Path,
    folder: Path,
    environment: Mapping[str, str],
    show: Callable[[str], None],
    tour: Tour,
    model: str | None = None,
) -> list[Path]:
    """Plan one problem of each family and draw it; the pictures.

    Args:
        url: of the inference API.
        root: the project's root.
        folder: for the pictures; made if it is not there.
        environment: of the command.
        show: takes the command's lines.
        tour: whose problems.
        model: that is asked; None for the API's default.

    Raises:
        PlanningError: the command failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [folder / f"plan-{family}.png" for family in tour.families]
    # The default robot and the default model need no words.
    named = [] if model is None else ["--robot", tour.robot, "--model", model]
    for family, picture in zip(tour.families, pictures, strict=True):
        picture.unlink(missing_ok=True)
        # A process of its own: OMPL seeds its generator once a process.
        arguments = ["--api", url, *named, "--family", family, "--seed", str(PLANNING_SEED), "--plot", str(picture)]
        show(f"$ python -m services.planner {' '.join(arguments)}")
        outcome = subprocess.run(
            [sys.executable, "-m", "services.planner", *arguments],
            cwd=root,
            env=dict(environment),
            capture_output=True,
            text=True,
            check=False,
            timeout=PLANNING_LIMIT_S,
        )
        for line in outcome.stdout.splitlines():
            show(line)
        # A crash ends with the same code, but draws nothing.
        if outcome.returncode not in (0, NOT_SOLVED) or not picture.is_file():
            raise PlanningError(
                f"the planner failed on the family {family}",
                got=f"exit code {outcome.returncode}: {outcome.stderr[-1000:] or outcome.stdout[-1000:]}",
            )
    return pictures
