"""All graphs of a bundle, opened and held against its description."""

from dataclasses import dataclass

from cspace.bundle.files import (
    ENCODER_FILE,
    GENERATOR_FILE,
    MAP_FILE,
    NOVELTY_FILE,
    VALIDITY_FILE,
    BundleFiles,
)
from cspace.bundle.running.graphs import Graph
from cspace.bundle.spec import MAP, WAYS, BundleSpec
from cspace.errors import BundleIntegrityError


@dataclass(frozen=True, slots=True, eq=False)
class GraphSet:
    """The graphs; None for what a bundle is without."""

    encoder: Graph
    generator: Graph | None
    validity: Graph | None
    novelty: Graph | None
    map: Graph | None


def open_graphs(spec: BundleSpec, files: BundleFiles, run_limit_s: float) -> GraphSet:
    """Open them.

    Args:
        spec: what they have to fit.
        files: their bytes.
        run_limit_s: how long one run of one graph may take.

    Raises:
        BundleIntegrityError: one does not fit, is missing, or is more than the description says.
    """

    def opened(
        name: str,
        inputs: set[str],
        outputs: set[str],
        perhaps: frozenset[str] = frozenset(),
    ) -> Graph | None:
        model = files.contents.get(name)
        return None if model is None else Graph(name, model, inputs, outputs, run_limit_s, perhaps)

    drawn = {item.name for item in spec.random_inputs}
    encoder = Graph(ENCODER_FILE, files.contents[ENCODER_FILE], {"image"}, {"mu", "sigma"}, run_limit_s)
    seen = opened(MAP_FILE, {"image"}, {"map"})
    if seen is not None:
        seen.sizes("map")
    perhaps = frozenset[str]() if seen is None else frozenset({MAP})
    generator = opened(GENERATOR_FILE, {"latent", *drawn, *spec.conditions}, {"samples"})
    _check_whole(GENERATOR_FILE, generator, "a model kind that has one", described=spec.model_kind != WAYS)
    validity = opened(VALIDITY_FILE, {"image", "configurations"}, {"confidence"}, perhaps)
    looked_at = spec.looks_at_map or (validity is not None and validity.takes(MAP))
    _check_whole(MAP_FILE, seen, "the condition map", described=looked_at)
    scores = opened(NOVELTY_FILE, {"image", "mu"}, {"scores"})
    _check_whole(NOVELTY_FILE, scores, "novelty_quantiles", described=spec.novelty_quantiles is not None)
    return GraphSet(encoder, generator, validity, scores, seen)


def _check_whole(name: str, graph: Graph | None, beside: str, *, described: bool) -> None:
    if (graph is None) == described:
        raise BundleIntegrityError(
            f"the bundle's {name} and its description do not fit",
            expected=f"{name} and {beside}, or neither",
            got="one of them",
        )
