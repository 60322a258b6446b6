"""A path sampler of a bundle's validity head; nothing is trained.

Paths are searched for when samples are requested. The head chooses among them, and samples are drawn along
them (:mod:`cspace.bundle.drawing.along_ways`).
"""

from pathlib import Path

from cspace.bundle import Bundle
from cspace.bundle.files import VALIDITY_FILE
from cspace.errors import BundleError
from training.paths.writing import PathGraph, write_path_bundle


def make_path_bundle(source: Bundle, folder: Path) -> Bundle:
    """Write a path sampler that sees with another bundle's head, encodes as it does, and knows its novelty.

    Args:
        source: a bundle with a validity head.
        folder: where the path sampler is to be; must not exist.

    Raises:
        BundleError: the source has no validity head.
        StorageError: the folder exists or cannot be written.
    """
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(source.folder))
    origin = source.spec.provenance
    return write_path_bundle(
        folder, source, PathGraph(None), origin.data_digest, origin.seeds, _recipe(source)
    )


def made_or_found(source: Bundle, folder: Path) -> Bundle:
    """The path sampler that the folder holds already, or one that is made there.

    Raises:
        CspaceError: as :func:`make_path_bundle`; what the folder holds was made of something else.
    """
    if folder.is_dir():
        found = Bundle.load(folder)
        if found.spec.provenance.config == _recipe(source):
            return found
    return make_path_bundle(source, folder)


def _recipe(source: Bundle) -> dict[str, object]:
    return {"ways": "searched", "source_digest": source.digest}
