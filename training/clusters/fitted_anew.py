"""A bundle with another description and the same networks."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cspace.bundle import Bundle, BundleSpec, graphs_of, write_bundle
from cspace.bundle.files import GOLDEN_FILE, VALIDITY_FILE
from cspace.bundle.golden import GoldenCase
from cspace.errors import BundleError


def require_head(source: Bundle) -> None:
    """Refuse a bundle that scores nothing.

    Raises:
        BundleError: it has no validity head.
    """
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(source.folder))


def write_fitted(source: Bundle, folder: Path, spec: BundleSpec, name: str, note: Mapping[str, Any]) -> Path:
    """Write a bundle's networks and golden case with a description of which something was fitted anew.

    Args:
        source: whose networks.
        folder: where the new one goes; must not exist.
        spec: of the source, with what was fitted.
        name: of what its making is told of beside that of the source, ``*_fitted_anew``.
        note: what is told; the digest of the source comes with it.

    Raises:
        BundleError: the parts do not make a bundle; nothing is left behind.
        StorageError: the folder exists or cannot be written.
    """
    told = {f"{name}_fitted_anew": {**note, "source_digest": source.digest}}
    provenance = replace(spec.provenance, config={**spec.provenance.config, **told})
    golden = GoldenCase.from_npz((source.folder / GOLDEN_FILE).read_bytes())
    return write_bundle(folder, replace(spec, provenance=provenance), graphs_of(source.folder), golden)
