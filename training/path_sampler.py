"""``python -m training.path_sampler BUNDLE FOLDER``: a path sampler of a bundle's validity head.

Nothing is trained: paths are searched for when samples are requested, the head chooses among them, and
samples are drawn along them. The command writes a bundle of the kind ``path``, which the inference API
serves like any other; with ``--register`` it becomes a version of ``path-sampler``, or of
``<robot>-path-sampler`` for a robot other than the default one.

A folder that holds this very path sampler already is taken as it is, so that the command may be given again.

Exit codes: 0 done, 1 the bundle, the disk or the registry is bad, 2 the command is wrong.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cspace.bundle import Bundle, RandomInput, load_verified, write_bundle
from cspace.bundle.files import ENCODER_FILE, MAP_FILE, NOVELTY_FILE, VALIDITY_FILE
from cspace.bundle.spec import WAYS
from cspace.errors import BundleError, CspaceError, InputError
from services.commands import report_error
from services.names import model_name, recorded_name
from services.registry import tracking_uri
from training.jobs.job import ALIASES, register_untrained
from training.jobs.provenance import provenance

_TAKEN = {"encoder": ENCODER_FILE, "validity": VALIDITY_FILE, "novelty": NOVELTY_FILE, "map": MAP_FILE}


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, make, print."""
    options = parser().parse_args(arguments)
    try:
        uri = None if options.register is None else tracking_uri()
        source = load_verified(options.bundle)
        named = options.robot_name or recorded_name(source.spec.provenance.config)
        model = model_name(source.spec.world, named, path=True)
        bundle = made_or_found(source, options.folder)
        print(f"{bundle.folder}\n  digest {bundle.digest}")
        if uri is not None:
            version = register_untrained(bundle, uri, model, options.register, "path-sampler")
            print(f"  registered as {version}")
    except CspaceError as error:
        return report_error(error, InputError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.path_sampler",
        description="Make a path sampler of a bundle's validity head; nothing is trained.",
        epilog="Reads MLFLOW_TRACKING_URI with --register. Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="a bundle with a validity head")
    parser.add_argument("folder", type=Path, help="where the path sampler goes")
    parser.add_argument(
        "--register",
        choices=ALIASES,
        help="make it a version of the robot's model of paths with this alias",
    )
    parser.add_argument("--robot-name", help="as of training jobs (default: the one in the bundle)")
    return parser


def made_or_found(source: Bundle, folder: Path) -> Bundle:
    """The path sampler that the folder holds already, or one that is made there."""
    if folder.is_dir():
        found = Bundle.load(folder)
        if found.spec.provenance.config == _recipe(source):
            return found
    return make_path_bundle(source, folder)


def make_path_bundle(source: Bundle, folder: Path) -> Bundle:
    """Write a path sampler that sees with another bundle's head, encodes as it does, knows its novelty."""
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(source.folder))
    origin = source.spec.provenance
    return write_path_bundle(folder, source, None, (), origin.data_digest, origin.seeds, _recipe(source))


def _recipe(source: Bundle) -> dict[str, object]:
    return {"ways": "searched", "source_digest": source.digest}


def write_path_bundle(
    folder: Path,
    source: Bundle,
    generator: bytes | None,
    random_inputs: tuple[RandomInput, ...],
    data_digest: str | None,
    seeds: Mapping[str, Any],
    recipe: Mapping[str, Any],
    metrics: Mapping[str, Any] | None = None,
) -> Bundle:
    """Write a path sampler with another bundle's encoder, head and novelty, and load it again.

    ``generator`` ONNX bytes: ``latent`` (m, L), the random inputs, ``start`` and ``goal`` (m, d) rad to
    ``samples`` (m, 1, d) rad; None for the search.
    """
    found = {name: source.folder / file for name, file in _TAKEN.items()}
    # A map that the source's generator alone looks at goes with it.
    if not source.head_looks_at_map:
        del found["map"]
    graphs = {name: file.read_bytes() for name, file in found.items() if file.is_file()}
    graphs |= {} if generator is None else {"generator": generator}
    spec = replace(
        source.spec,
        kind="path",
        model_kind="generator" if generator else WAYS,
        looks_at_picture=False,
        looks_at_map=False,
        samples_per_latent=1,
        random_inputs=random_inputs,
        standardisation=None,
        # A planner drops what collides by itself, and a passage that the head closes keeps its samples.
        confidence_threshold=0.0 if source.has_validity else None,
        provenance=provenance(recipe, data_digest=data_digest, seeds=seeds, metrics=metrics or {}),
    )
    return Bundle.load(write_bundle(folder, spec, graphs))


if __name__ == "__main__":
    sys.exit(main())
