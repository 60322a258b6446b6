"""``python -m training.proposals BUNDLE FOLDER``: choose the proposals of a bundle again.

A request that filters mixes uniform proposals among the generator's. How many, and at which confidence, is
chosen by what either costs and how many pass, as training does it; graphs that became cheaper, and bundles of
earlier releases, may be better off with another mixture. The networks stay as they are, and so does the
golden case; what the bundle tells of its making gets a note of the bundle that it comes from.

Exit codes: 0 done, 1 the bundle or the disk is bad, 2 the command is wrong.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.errors import BundleError, CspaceError, InputError
from services.command_errors import report_error
from training.clusters.bundling import THRESHOLD_SCENARIOS, fit_proposals
from training.clusters.calibration import require_head, write_fitted
from training.clusters.proposals import Choice
from training.config import HeadConfig


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, draw, choose, write."""
    options = parser().parse_args(arguments)
    try:
        source = load_verified(options.bundle)
        found = _fitted(source)
        note = {"scenarios": THRESHOLD_SCENARIOS}
        folder = write_fitted(source, options.folder, found.stated_in(source.spec), "proposals", note)
    except CspaceError as error:
        return report_error(error, InputError)
    sys.stdout.write(
        f"{folder}\n  uniform_share {found.share}, threshold {found.threshold}\n  {_costs_text(found)}\n"
    )
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.proposals",
        description="Fit again how many of a bundle's proposals are uniform; its networks stay as they are.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="of free configurations, with a validity head")
    parser.add_argument("folder", type=Path, help="where the new one goes; must not exist")
    return parser


def _fitted(source: Bundle) -> Choice:
    require_head(source)
    spec = source.spec
    if spec.kind == "path" or spec.confidence_threshold is None:
        raise BundleError(
            "the bundle mixes no proposals",
            expected="free configurations, and a threshold",
            got=f"a {spec.kind} bundle with the threshold {spec.confidence_threshold}",
        )
    # The bound holds at the threshold that it was computed for.
    bounded = any(name.startswith("promise/") for name in spec.provenance.metrics)
    target_acceptance = float(HeadConfig.model_fields["target_acceptance"].default)
    return fit_proposals(source, spec.confidence_threshold, target_acceptance, fixed=bounded)


def _costs_text(found: Choice) -> str:
    costs = found.costs
    kinds = {"learned": costs.learned_s, "uniform": costs.uniform_s, "scored": costs.head_s}
    each = ", ".join(f"{name} {1e6 * value:.2f}" for name, value in kinds.items())
    return f"us a configuration: {each}; a sample {1e6 * found.cost_s:.2f}, alone {1e6 * found.alone_s:.2f}"


if __name__ == "__main__":
    sys.exit(main())
