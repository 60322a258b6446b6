"""``python -m training.plan_confidence BUNDLE FOLDER``: recalibrate the plans of a bundle.

The share of free plans at a given cost depends on the search, which changes now and then, and on the number
of pictures, each of which has its own calibration. This command plans in validation scenes with the current
search, as training does with ``validity.plan_problems``, and writes the bundle with the new calibration.
Networks and golden case stay as they are; the provenance names the source bundle.

Exit codes: 0 done, 1 the bundle or the disk is bad, 2 the command is wrong.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.bundle import Bundle, load_verified
from cspace.bundle.files import VALIDITY_FILE
from cspace.errors import BundleError, ConfigError, CspaceError, InputError
from services.commands import report_error
from training.clusters.calibration import (
    PlanCalibration,
    fit_plan_calibration,
    planned,
    write_fitted,
)

# Fewer say nothing: each third of the plans is predicted from the others.
_LEAST = 6


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, plan, fit, write."""
    options = parser().parse_args(arguments)
    try:
        source = load_verified(options.bundle)
        found = _fitted(source, options.problems)
        note = {"plan_problems": options.problems}
        folder = write_fitted(source, options.folder, found.stated_in(source.spec), "plans", note)
    except CspaceError as error:
        return report_error(error, InputError)
    metrics_text = ", ".join(
        f"{name.removeprefix('plans/')} {value:.3g}" for name, value in found.metrics().items()
    )
    sys.stdout.write(f"{folder}\n  plan_calibration {found.parameters}\n  {metrics_text}\n")
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.plan_confidence",
        description="Recalibrate the confidence of a bundle's plans; its networks stay as they are.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="a bundle with a validity head")
    parser.add_argument("folder", type=Path, help="where the new one goes; must not exist")
    parser.add_argument("--problems", type=int, default=990, help="to plan in (default: %(default)s)")
    return parser


def _fitted(source: Bundle, problems: int) -> PlanCalibration:
    if problems < _LEAST:
        raise ConfigError("too few problems to fit anything", expected=f"{_LEAST} or more", got=str(problems))
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(source.folder))
    found = fit_plan_calibration(planned(source, source.spec.world, problems))
    if found is None:
        raise BundleError(
            "too few plans were found to fit anything",
            got=f"of {problems} problems",
            remedy="give more with --problems",
        )
    return found


if __name__ == "__main__":
    sys.exit(main())
