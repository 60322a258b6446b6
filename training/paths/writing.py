"""A path sampler's graph as a bundle that sees with the source's encoder and validity head; no torch."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cspace.bundle import Bundle, Provenance, RandomInput, write_bundle
from cspace.bundle.files import ENCODER_FILE, MAP_FILE, NOVELTY_FILE, VALIDITY_FILE
from cspace.bundle.spec import WAYS
from training.jobs.provenance import command_line, now, source_state

_TAKEN = {"encoder": ENCODER_FILE, "validity": VALIDITY_FILE, "novelty": NOVELTY_FILE, "map": MAP_FILE}


@dataclass(frozen=True, slots=True)
class PathGraph:
    """A path model's graph.

    Args:
        model: ONNX bytes: ``latent`` (m, L), the random inputs, ``start`` and ``goal`` (m, d) rad and, where
            it looks at it, ``image`` (1, 3, P, P) to ``samples`` (m, 1, d) rad; None for a search.
        random_inputs: in the order in which they are drawn.
        looks_at_picture: whether it takes ``image``.
    """

    model: bytes | None
    random_inputs: tuple[RandomInput, ...] = ()
    looks_at_picture: bool = False


def write_path_bundle(
    folder: Path,
    source: Bundle,
    graph: PathGraph,
    data_digest: str | None,
    seeds: Mapping[str, Any],
    recipe: Mapping[str, Any],
    metrics: Mapping[str, Any] | None = None,
) -> Bundle:
    """Write a path sampler that encodes, scores and knows novelty as another bundle does, and load it again.

    Args:
        folder: must not exist.
        source: whose encoder, head and novelty it takes.
        graph: of the sampler.
        data_digest: of what it was trained on.
        seeds: by stage.
        recipe: how it was made; plain values.
        metrics: what was measured; plain values.

    Raises:
        BundleError: the parts do not make a bundle.
        StorageError: the folder exists or cannot be written.
    """
    found = {name: source.folder / file for name, file in _TAKEN.items()}
    # A map that the source's generator alone looks at goes with it.
    if not source.head_looks_at_map:
        del found["map"]
    graphs = {name: file.read_bytes() for name, file in found.items() if file.is_file()}
    graphs |= {} if graph.model is None else {"generator": graph.model}
    state = source_state()
    spec = replace(
        source.spec,
        kind="path",
        model_kind="generator" if graph.model else WAYS,
        looks_at_picture=graph.looks_at_picture,
        looks_at_map=False,
        samples_per_latent=1,
        random_inputs=graph.random_inputs,
        standardisation=None,
        # A planner drops what collides by itself, and a passage that the head closes keeps its samples.
        confidence_threshold=0.0 if source.has_validity else None,
        uniform_share=0.0,
        provenance=Provenance(
            git_commit=state.commit,
            git_dirty=state.dirty,
            data_digest=data_digest,
            seeds=seeds,
            config=recipe,
            metrics=metrics or {},
            created=now(),
            command=command_line(),
        ),
    )
    return Bundle.load(write_bundle(folder, spec, graphs))
