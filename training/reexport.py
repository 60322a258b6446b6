"""``python -m training.reexport BUNDLE FOLDER``: a bundle's graphs, exported anew from their own weights.

Nothing is trained. The validity graph, and in the plane that of a mixture, are read back into the networks
that they were exported of, and those are exported as this release does it, which may be quicker to compute.
All other graphs stay as they are, byte for byte. Old and new ones must answer alike, or nothing is written;
what the bundle tells of its making keeps its words, with a note of the bundle that it comes from.

Exit codes: 0 done, 1 the bundle or the disk is bad, or the graphs differ, 2 the command is wrong.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle, graphs_of, write_bundle
from cspace.bundle.files import GOLDEN_FILE, VALIDITY_FILE
from cspace.bundle.golden import GoldenCase, scene
from cspace.errors import BundleError, CspaceError, InputError
from cspace.files import replacing
from services.command_errors import tell_error
from training.models.anew.planar import MIXTURE, planar_graphs
from training.models.anew.reading_back import read_back
from training.models.grids.export import grid_validity_graph
from training.models.grids.head import GridHead
from training.models.settings import GridConfig

# Configurations that both graphs are asked about, and samples of both, of each of so many pictures.
_ASKED, _TURNS = 1000, 4
# Between the answers; and the share of configurations that may be further apart, as a sphere's middle that
# lies on the border of two voxels may be counted to either.
ALIKE, _ON_BORDERS = 1e-5, 1e-3


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, export, print."""
    options = parser().parse_args(arguments)
    try:
        source = Bundle.load(options.bundle)
        bundle = reexported(source, options.folder)
        print(f"{bundle.folder}\n  digest {bundle.digest}")
        print(f"  answers differ by {apart(source, bundle).max():.1e} at most")
    except CspaceError as error:
        return tell_error(error, InputError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.reexport",
        description="Export a bundle's graphs anew from their own weights; nothing is trained.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="whose head or mixture is exported anew")
    parser.add_argument("folder", type=Path, help="where the new bundle goes")
    return parser


def reexported(source: Bundle, folder: Path) -> Bundle:
    """Write the bundle with its validity graph, and that of a planar mixture, exported anew.

    Args:
        source: a bundle of an arm in space with a head that reads the map of its pictures, or of the plane
            with a head or a mixture.
        folder: where the new one is to be; must not exist.

    Raises:
        BundleError: the source has no such graphs, their weights cannot be read, or the new ones answer
            otherwise; nothing is left behind.
        StorageError: the folder exists or cannot be written.
    """
    is_flat = source.spec.world.sensor.extent_m is not None
    made = planar_graphs(source) if is_flat else _grid_graphs(source)
    origin = source.spec.provenance
    note = {"graphs": sorted(made), "source_digest": source.digest}
    spec = replace(source.spec, provenance=replace(origin, config={**origin.config, "exported_anew": note}))
    graphs = graphs_of(source.folder) | made
    # The golden case stays: what the bundle promised holds on, within its tolerance, or it is not loaded.
    golden = GoldenCase.from_npz((source.folder / GOLDEN_FILE).read_bytes())
    with replacing(Path(folder), "the bundle") as beside:
        _require_alike(source, Bundle.load(write_bundle(beside, spec, graphs, golden), replay=False))
    return Bundle.load(folder, replay=False)


def apart(one: Bundle, other: Bundle) -> NDArray[np.float32]:
    """How far the answers of two bundles are apart, (m,).

    Of uniform configurations the farther of confidence and unseen share, of a mixture's samples the farthest
    joint in rad; in the fixed picture of golden cases, moved further from case to case.
    """
    rng, space = np.random.default_rng(0), one.spec.world.space
    picture = scene(one.spec.world.sensor.picture_shape)
    found = []
    for turn in range(_TURNS):
        rows = space.to_float32(space.sample_uniform(rng, _ASKED))
        shown = np.roll(picture, [turn * side // _TURNS for side in picture.shape[:3]], axis=(0, 1, 2))
        if one.has_validity:
            first, second = (bundle.believe(shown, rows) for bundle in (one, other))
            gaps = [
                np.abs(a - b) for a, b in zip(first, second, strict=True) if a is not None and b is not None
            ]
            found.append(np.max(gaps, axis=0))
        if one.spec.model_kind == MIXTURE:
            drawn = [
                bundle.sample(shown, _ASKED, turn, min_confidence=0.0).samples for bundle in (one, other)
            ]
            found.append(np.abs(space.difference(*drawn)).max(axis=1).astype(np.float32))
    return np.concatenate(found)


def _require_alike(source: Bundle, made: Bundle) -> None:
    gaps = apart(source, made)
    if np.mean(gaps > ALIKE) > _ON_BORDERS:
        raise BundleError(
            "the new graphs answer otherwise than those that they were read from",
            expected=f"within {ALIKE:g} but for one in {1 / _ON_BORDERS:g}",
            got=f"{np.mean(gaps > ALIKE):.3f} farther apart, by {gaps.max():.1e} at most",
        )


def _grid_graphs(source: Bundle) -> dict[str, bytes]:
    head = _head_of(source)
    read_back(head, (source.folder / VALIDITY_FILE).read_bytes())
    return {"validity": grid_validity_graph(head, source.spec.dim)}


def _head_of(source: Bundle) -> GridHead:
    """A head of the sizes that the bundle tells, on which its validity graph's weights fit."""
    config = source.spec.provenance.config.get("validity")
    sizes = config.get("grid") if isinstance(config, dict) else None
    if not source.head_looks_at_map or not isinstance(config, dict) or not isinstance(sizes, dict):
        raise BundleError(
            "the bundle's head cannot be exported anew",
            expected="one of an arm in space, with its sizes under validity.grid",
            got=f"a bundle of the world {source.spec.world.kind}",
        )
    try:
        grid, hidden = GridConfig(**sizes), int(config["hidden"])
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError("the sizes of the bundle's head cannot be read", got=str(error)[:200]) from error
    x, y, z, _ = source.spec.world.sensor.picture_shape
    return GridHead(grid, hidden, source.spec.world.grid_arm(grid.groups), (x, y, z)).eval()


if __name__ == "__main__":
    sys.exit(main())
