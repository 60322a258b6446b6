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
from dataclasses import replace
from pathlib import Path

from cspace.bundle import graphs_of, load_verified, write_bundle
from cspace.bundle.files import GOLDEN_FILE, VALIDITY_FILE, GoldenCase
from cspace.errors import BundleError, CspaceError, InputError
from services.commands import report_error
from training.clusters.calibration import fit_plan_calibration, planned


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, plan, fit, write."""
    options = parser().parse_args(arguments)
    try:
        metrics = recalibrate(options.bundle, options.folder, options.problems)
    except CspaceError as error:
        return report_error(error, InputError)
    lines = [str(options.folder), *(f"  {name} {value:.3g}" for name, value in metrics.items())]
    sys.stdout.write("\n".join(lines) + "\n")
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


def recalibrate(bundle: Path, folder: Path, problems: int) -> dict[str, float]:
    """Write the bundle with plans that are calibrated anew; what was measured."""
    source = load_verified(bundle)
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(bundle))
    found = fit_plan_calibration(planned(source, source.spec.world, problems))
    if found is None:
        raise BundleError(
            "too few plans were found to fit anything",
            got=f"of {problems} problems",
            remedy="give more with --problems",
        )
    spec = found.stated_in(source.spec)
    note = {"plan_problems": problems, "source_digest": source.digest}
    provenance = replace(spec.provenance, config={**spec.provenance.config, "plans_fitted_again": note})
    golden = GoldenCase.from_npz((source.folder / GOLDEN_FILE).read_bytes())
    write_bundle(folder, replace(spec, provenance=provenance), graphs_of(source.folder), golden)
    return dict(found.metrics)


if __name__ == "__main__":
    sys.exit(main())
