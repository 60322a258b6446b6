"""Writing a bundle: golden case, sums, and a folder that appears whole or not at all."""

from collections.abc import Mapping
from pathlib import Path

from cspace.bundle.files import (
    ENCODER_FILE,
    GENERATOR_FILE,
    GOLDEN_FILE,
    MAP_FILE,
    NOVELTY_FILE,
    SPEC_FILE,
    SUMS_FILE,
    VALIDITY_FILE,
    BundleFiles,
    sums_of,
)
from cspace.bundle.golden import GoldenCase, endpoints, scene
from cspace.bundle.loaded import Bundle
from cspace.bundle.spec import BundleSpec
from cspace.errors import BundleIntegrityError, StorageError
from cspace.files import replacing
from cspace.query import SampleQuery

GOLDEN_SEED = 20_240_229
# Odd, so that it is a multiple of no usual number of samples per latent.
GOLDEN_COUNT = 65
GOLDEN_EPSILON = (0.0, 0.5)

_GRAPH_FILES = {
    "encoder": ENCODER_FILE,
    "generator": GENERATOR_FILE,
    "validity": VALIDITY_FILE,
    "novelty": NOVELTY_FILE,
    "map": MAP_FILE,
}


def write_bundle(
    folder: Path, spec: BundleSpec, graphs: Mapping[str, bytes], golden: GoldenCase | None = None
) -> Path:
    """Write a bundle beside its place, load it there as any reader would, and rename it.

    Args:
        folder: where the bundle is to be; must not exist.
        spec: its description.
        graphs: ``encoder``, and as the description asks for ``generator``, ``validity``, ``novelty`` and
            ``map``, to ONNX bytes.
        golden: the golden case; computed from a fixed picture and seed when None.

    Returns:
        The folder.

    Raises:
        BundleError: the parts do not make a bundle; nothing is left behind.
        StorageError: the folder exists or cannot be written.
    """
    folder = Path(folder)
    contents = {SPEC_FILE: spec.to_json(), **_graph_files(graphs)}
    case = golden if golden is not None else _compute_golden(folder, contents)
    contents[GOLDEN_FILE] = case.to_npz()
    if folder.exists():
        raise StorageError(
            "the bundle's folder exists", expected="a new folder", got=folder.name, remedy="choose another"
        )
    with replacing(folder, "the bundle") as beside:
        beside.mkdir(parents=True)
        for name, data in {**contents, SUMS_FILE: sums_of(contents)}.items():
            (beside / name).write_bytes(data)
        Bundle.load(beside)
    return folder


def graphs_of(folder: Path) -> dict[str, bytes]:
    """The graphs of a bundle as :func:`write_bundle` takes them, from its folder."""
    files = {name: folder / file for name, file in _GRAPH_FILES.items()}
    return {name: file.read_bytes() for name, file in files.items() if file.is_file()}


def _graph_files(graphs: Mapping[str, bytes]) -> dict[str, bytes]:
    if not {"encoder"} <= set(graphs) <= set(_GRAPH_FILES):
        raise BundleIntegrityError(
            "the bundle's graphs do not fit",
            expected="encoder and optionally generator, validity, novelty and map",
            got=", ".join(sorted(graphs)),
        )
    return {_GRAPH_FILES[name]: data for name, data in graphs.items()}


def _compute_golden(folder: Path, contents: Mapping[str, bytes]) -> GoldenCase:
    bundle = Bundle(folder, BundleFiles(contents, digest=""))
    image = scene(bundle.spec.world.sensor.picture_shape)
    start, goal = endpoints(bundle.spec.endpoints, bundle.spec.world.space)
    query = SampleQuery(GOLDEN_COUNT, GOLDEN_SEED, GOLDEN_EPSILON, start, goal, min_confidence=0.0)
    encoding, answer = bundle.encode(image), bundle.golden_answer(image, query)
    return GoldenCase(image, query, encoding.mu, encoding.sigma, answer.samples, answer.confidence)
