"""A path sampler of a bundle's validity head; nothing is trained.

With two joints the head's map of the joint space, the cheapest way through it and a tube round that make the
samples (:mod:`training.paths.ways`). With more, ways are searched for when they are asked for, and the head
says which of them it doubts least (:mod:`cspace.bundle.drawing.along_ways`).
"""

from dataclasses import asdict
from pathlib import Path

from cspace.bundle import Bundle
from cspace.bundle.files import VALIDITY_FILE
from cspace.errors import BundleError
from training.paths.ways import PLANE, WaySettings, way_graph
from training.paths.writing import PathGraph, write_path_bundle


def make_path_bundle(source: Bundle, folder: Path, settings: WaySettings | None = None) -> Bundle:
    """Write a path sampler that sees with another bundle's head, encodes as it does, and knows its novelty.

    Args:
        source: a bundle with a validity head.
        folder: where the path sampler is to be; must not exist.
        settings: how the way is found on the map; looked at with two joints alone.

    Raises:
        BundleError: the source has no validity head.
        StorageError: the folder exists or cannot be written.
    """
    settings = settings or WaySettings()
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(source.folder))
    graph = PathGraph(None)
    if source.spec.dim == PLANE:
        head = (source.folder / VALIDITY_FILE).read_bytes()
        graph = way_graph(head, source.spec.world.space, source.spec.latent_dim, settings)
    origin = source.spec.provenance
    return write_path_bundle(
        folder, source, graph, origin.data_digest, origin.seeds, _recipe(source, settings)
    )


def made_or_found(source: Bundle, folder: Path, settings: WaySettings) -> Bundle:
    """The path sampler that the folder holds already, or one that is made there.

    Raises:
        CspaceError: as :func:`make_path_bundle`; what the folder holds was made of something else.
    """
    if folder.is_dir():
        found = Bundle.load(folder)
        if found.spec.provenance.config == _recipe(source, settings):
            return found
    return make_path_bundle(source, folder, settings)


def _recipe(source: Bundle, settings: WaySettings) -> dict[str, object]:
    ways = asdict(settings) if source.spec.dim == PLANE else "searched"
    return {"ways": ways, "source_digest": source.digest}
