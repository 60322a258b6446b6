"""A path sampler that needs no training on paths: the validity head's map, the cheapest way, a tube round it.

The head tells how free each cell of a grid over the joint space is. Sweeps over the grid spread what the way
to the goal costs, a walk from the start follows it, and the samples lie round points at random shares of the
way's length. All of that is two ONNX graphs, so that a bundle holds it as any other generator: the map, which
a picture needs once, and the way.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, inliner, numpy_helper

from cspace.bundle import RandomInput
from cspace.errors import ConfigError
from cspace.space import JointSpace
from training.models.lookups.head_map import MAP, map_graph, named, shaped
from training.models.ways.graph import fixed, way_constants
from training.models.ways.steps import way_samples
from training.paths.writing import PathGraph

PLANE = 2


@dataclass(frozen=True, slots=True)
class WaySettings:
    """How the way is found.

    Args:
        cells: along each joint.
        penalty: what a rad costs more where the head is sure of a collision. No cell is ruled out, for what
            is narrower than a cell looks half blocked.
        levels: a confidence is read in so many steps; what differs by rounding alone is the same way on every
            machine.
        sweeps: how often costs spread, and the longest way in cells.
        gap_rad: between the samples of one sweep from start to goal, before the next begin at the start
            again; with 0 they come in no order. A tree that grows from the start can use them best from the
            start on.
        tube_rad: standard deviation of the first sweep's samples about the way.
        widening_rad: what each further sweep adds to it, for the way may be wrong.
        widest_rad: up to here; of all samples where they come in no order.

    Raises:
        ConfigError: a value is out of its range.
    """

    cells: int = 48
    penalty: float = 20.0
    levels: int = 64
    sweeps: int = 64
    gap_rad: float = 0.3
    tube_rad: float = 0.04
    widening_rad: float = 0.01
    widest_rad: float = 0.15

    def __post_init__(self) -> None:
        leasts = {"cells": 3, "levels": 1, "sweeps": 1}
        for item in fields(self):
            value, least = getattr(self, item.name), leasts.get(item.name, 0)
            if not least <= value < math.inf:
                raise ConfigError(
                    f"{item.name} is out of range", expected=f"at least {least}", got=repr(value)
                )


def way_graph(
    validity: bytes, space: JointSpace, latent_dim: int, settings: WaySettings | None = None
) -> PathGraph:
    """A bundle's path sampler by the map of its validity head.

    Args:
        validity: the head's graph: ``image`` (1, 3, P, P), ``configurations`` (n, d) to ``confidence`` (n,).
        space: the joint space, of two joints.
        latent_dim: L; the latent is taken, as of all generators, and not looked at.
        settings: how the way is found.

    Returns:
        The map's graph, and one from ``latent`` (m, L), ``place`` (m, 1) in [0, 1), ``jitter`` (m, 2)
        standard normal, ``map`` (k,), ``start`` and ``goal`` (m, 2) rad, all rows alike, to ``samples``
        (m, 1, 2) rad.

    Raises:
        ConfigError: the space has not two joints.
    """
    settings = settings or WaySettings()
    if space.dim != PLANE:
        raise ConfigError(
            "ways are searched on a grid of two joints", expected="2 joints", got=str(space.dim)
        )
    constants = _constants(space, settings)
    source = way_samples.to_model_proto()  # type: ignore[no-untyped-call]
    ways = fixed(inliner.inline_local_functions(source), constants)
    named(ways, "confidence", MAP)
    _keep_within(ways, space)
    (samples,) = ways.graph.output
    ways.graph.output.remove(samples)
    ways.graph.output.append(shaped("samples", "latents", 1, PLANE))
    ways.graph.input.append(shaped("latent", "latents", latent_dim))
    onnx.checker.check_model(ways)
    random = (RandomInput("place", "uniform", (1,), 0.0, 1.0), RandomInput("jitter", "normal", (PLANE,)))
    return PathGraph(ways.SerializeToString(), random, map=map_graph(validity, constants["grid"]))


def _keep_within(ways: onnx.ModelProto, space: JointSpace) -> None:
    """Let the samples of limited joints end at their limits; the tube round a way along one does not."""
    if space.is_torus:
        return
    named(ways, "samples", "unlimited")
    low, high = (
        np.where(space.periodic, side * np.inf, ends) for side, ends in ((-1, space.lower), (1, space.upper))
    )
    for name, ends in (("lowest", low), ("highest", high)):
        ways.graph.initializer.append(numpy_helper.from_array(ends.astype(np.float32), name))
    ways.graph.node.append(helper.make_node("Max", ["unlimited", "lowest"], ["above"]))
    ways.graph.node.append(helper.make_node("Min", ["above", "highest"], ["samples"]))
    ways.graph.output[0].name = "samples"


def _constants(space: JointSpace, settings: WaySettings) -> dict[str, NDArray[Any]]:
    return way_constants(space, settings.cells) | {
        "penalty": np.array(settings.penalty, dtype=np.float32),
        "levels": np.array(settings.levels, dtype=np.float32),
        "sweeps": np.array(settings.sweeps, dtype=np.int64),
        "tube": np.array(settings.tube_rad, dtype=np.float32),
        "widening": np.array(settings.widening_rad, dtype=np.float32),
        "widest": np.array(settings.widest_rad, dtype=np.float32),
        "gap": np.array([settings.gap_rad], dtype=np.float32),
    }
