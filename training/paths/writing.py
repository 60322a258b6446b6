"""Path samplers as bundles that see with a source's encoder and validity head; no torch."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cspace.bundle import Bundle, BundleSpec, RandomInput, load_verified, write_bundle
from cspace.bundle.files import ENCODER_FILE, MAP_FILE, NOVELTY_FILE, VALIDITY_FILE
from cspace.bundle.spec import WAYS
from cspace.errors import BundleError, ConfigError
from services.registry.entities import ModelReference
from services.registry.models import ModelRegistry
from training.jobs.provenance import provenance


def source_bundle(source: str, registry: ModelRegistry, folder: Path) -> Bundle:
    """A bundle's folder, or a registered version that is fetched."""
    if Path(source).is_absolute():
        return load_verified(Path(source))
    if folder.is_dir():
        return Bundle.load(folder)
    reference = ModelReference.parse_version(
        source, "the source of the path models is unknown", "a bundle's folder, name@alias or name/version"
    )
    return load_verified(registry.download(registry.look_up(reference), folder))


def require_source(start: Path | None, source: Bundle) -> None:
    """See that the job whose weights path models start from saw with the same encoder and head."""
    for made in () if start is None else start.glob("bundles/*/bundle.json"):
        seen_with = BundleSpec.from_json(made.read_bytes()).provenance.config.get("source_digest")
        if seen_with != source.digest:
            raise ConfigError(
                "source is not that of start_from",
                expected=f"the bundle {seen_with}",
                got=source.digest,
                remedy="set source to the version that those path models see with",
            )


_TAKEN = {"encoder": ENCODER_FILE, "validity": VALIDITY_FILE, "novelty": NOVELTY_FILE, "map": MAP_FILE}


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


def make_path_bundle(source: Bundle, folder: Path) -> Bundle:
    """Write a path sampler that sees with another bundle's head, encodes as it does, knows its novelty."""
    if not source.has_validity:
        raise BundleError("the bundle has no validity head", expected=VALIDITY_FILE, got=str(source.folder))
    origin = source.spec.provenance
    return write_path_bundle(folder, source, None, (), origin.data_digest, origin.seeds, _recipe(source))


def made_or_found(source: Bundle, folder: Path) -> Bundle:
    """The path sampler that the folder holds already, or one that is made there."""
    if folder.is_dir():
        found = Bundle.load(folder)
        if found.spec.provenance.config == _recipe(source):
            return found
    return make_path_bundle(source, folder)


def _recipe(source: Bundle) -> dict[str, object]:
    return {"ways": "searched", "source_digest": source.digest}
