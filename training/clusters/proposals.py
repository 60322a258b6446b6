"""The cheapest right proposals: the uniform share and the threshold, by the operations of the ONNX graphs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx
from numpy.typing import NDArray

from cspace.bundle import Bundle, BundleSpec, graphs_of
from cspace.bundle.runtime import onnx_runtime
from cspace.bundle.sampling import BUDGET, EXTRA
from cspace.simulator import Split
from cspace.world import World
from services.evaluator.scenes import Scene, Stage
from services.evaluator.statistics import mean_interval
from training.clusters.calibration import STREAM, Scored

# A multiplication with its addition in a matrix product or a convolution, an element of any other operation's
# answer, and starting an operation.
MULTIPLY_ADD_S, ELEMENT_S, NODE_S = 3e-11, 3e-10, 1.5e-6

# Other views of what is there.
_FREE = {"Constant", "Flatten", "Identity", "Reshape", "Shape", "Squeeze", "Unsqueeze"}


def run_cost(graph: bytes, rows: int, feeds: Mapping[str, NDArray[np.float32]]) -> float:
    """The cost of one run, s on a nominal core.

    Args:
        graph: an ONNX model without control flow.
        rows: of inputs whose number of rows is not fixed.
        feeds: inputs whose values decide what is computed; the others are zeros.
    """
    model = onnx.load_from_string(graph)
    fed = {one.name: feeds.get(one.name, _zeros(one, rows)) for one in model.graph.input}
    known = {one.name: tuple(one.dims) for one in model.graph.initializer}
    known |= {name: array.shape for name, array in fed.items()} | _shapes(model, fed)
    return sum(_node_cost(node, known) for node in model.graph.node)


def _zeros(one: onnx.ValueInfoProto, rows: int) -> NDArray[np.float32]:
    sizes = [size.dim_value or rows for size in one.type.tensor_type.shape.dim]
    return np.zeros(sizes, dtype=np.float32)


def _shapes(model: onnx.ModelProto, fed: Mapping[str, NDArray[np.float32]]) -> dict[str, tuple[int, ...]]:
    """Of every node's answers, by running the graph as it is written."""
    names = [name for node in model.graph.node for name in node.output if name]
    del model.graph.output[:]
    model.graph.output.extend(onnx.ValueInfoProto(name=name) for name in names)
    runtime = onnx_runtime()
    options = runtime.SessionOptions()
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.intra_op_num_threads = 1
    session = runtime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    found = session.run(names, {one.name: fed[one.name] for one in session.get_inputs()})
    return {name: np.shape(array) for name, array in zip(names, found, strict=True)}


def _node_cost(node: onnx.NodeProto, shapes: Mapping[str, tuple[int, ...]]) -> float:
    if node.op_type in _FREE:
        return 0.0
    elements = sum(math.prod(shapes[name]) for name in node.output if name)
    if node.op_type == "Conv":
        work = elements * math.prod(shapes[node.input[1]][1:]) * MULTIPLY_ADD_S
    elif node.op_type in ("Gemm", "MatMul"):
        turned = any(one.name == "transA" and one.i for one in node.attribute)
        work = elements * shapes[node.input[0]][0 if turned else -1] * MULTIPLY_ADD_S
    else:
        work = elements * ELEMENT_S
    return work + NODE_S


SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# Samples that are kept of a scene, and what may be drawn for them, as a request may.
KEPT = 500
SAMPLED = BUDGET * KEPT
# As many as a request draws.
ROWS = 300
# A uniform angle, on the core of graph_costs.
UNIFORM_ANGLE_S = 4.5e-8
# What saves less than this is no reason to leave the generator.
_WORTH = 0.95
# What may be missing beyond what the generator alone misses: one sample in a thousand.
_MISSED = 1e-3
# Fewer tell nothing of how near they are to the free configurations.
_FEWEST = 50


@dataclass(frozen=True, slots=True)
class Costs:
    """What a configuration costs, s on a nominal core: drawn by the generator, drawn uniformly, scored.

    ``turn_s`` is what a further turn costs, however few it draws.
    """

    learned_s: float
    uniform_s: float
    head_s: float
    turn_s: float = 0.0

    def of_one(self, share: float) -> float:
        """A proposal of a mixture with so many uniform ones, scored."""
        return (1.0 - share) * self.learned_s + share * self.uniform_s + self.head_s


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """Proposals of both kinds in one validation scenario, (n, d) each, as the head scores them.

    Args:
        scene: the scenario.
        held_out: (m, d) free configurations.
        learned: the generator's.
        learned_scored: their confidence, and whether they are free.
        uniform: uniform over the joint space.
        uniform_scored: likewise.
    """

    scene: Scene
    held_out: NDArray[np.float64]
    learned: NDArray[np.float32]
    learned_scored: Scored
    uniform: NDArray[np.float32]
    uniform_scored: Scored

    def mixed(self, share: float) -> tuple[NDArray[np.float32], Scored]:
        """As many proposals, so many of them uniform, in the order in which a request would draw them."""
        picks = self.scene.rng(STREAM + 1).random(len(self.learned)) < share
        confidence = np.where(picks, self.uniform_scored.confidence, self.learned_scored.confidence)
        free = np.where(picks, self.uniform_scored.free, self.learned_scored.free)
        return np.where(picks[:, None], self.uniform, self.learned), Scored(confidence, free)


@dataclass(frozen=True, slots=True)
class Outcome:
    """A mixture at a threshold over all scenes, (scenes,) each.

    Args:
        precision: share of what is kept that is free.
        coverage: of held-out configurations, where balls about samples tell something; else zeros.
        energy: distance to the free configurations.
        missing: share of what is wanted that all that may be drawn does not give.
        passing: share of proposals that pass.
        cost_s: of a sample that is kept.
    """

    precision: NDArray[np.float64]
    coverage: NDArray[np.float64]
    energy: NDArray[np.float64]
    missing: NDArray[np.float64]
    passing: NDArray[np.float64]
    cost_s: float

    def as_good_as(self, other: "Outcome") -> bool:
        """Whether each mean is within the other's 95 % interval, or better."""
        if not self.as_precise_as(other):
            return False
        rng = np.random.default_rng(0)
        return bool(
            self.energy.mean() <= mean_interval(other.energy, rng).high
            and self.coverage.mean() >= mean_interval(other.coverage, rng).low
            and self.missing.mean() <= other.missing.mean() + _MISSED
        )

    def as_precise_as(self, other: "Outcome") -> bool:
        """The same of the precision alone."""
        return float(self.precision.mean()) >= mean_interval(other.precision, np.random.default_rng(0)).low


@dataclass(frozen=True, slots=True)
class Choice:
    """What a bundle does for a request that filters.

    Args:
        share: of uniform proposals.
        threshold: of the confidence.
        passing: share of the first turn that is expected to pass; see :func:`first_turn`.
        costs: that decided.
        cost_s: of a sample that is kept, by them.
        alone_s: the same with the generator alone.
    """

    share: float
    threshold: float
    passing: float
    costs: Costs
    cost_s: float
    alone_s: float

    def stated_in(self, spec: BundleSpec) -> BundleSpec:
        """A bundle's description with what was chosen, and by what."""
        micro = {
            "learned_us": self.costs.learned_s,
            "uniform_us": self.costs.uniform_s,
            "head_us": self.costs.head_s,
            "kept_us": self.cost_s,
            "kept_by_generator_alone_us": self.alone_s,
        }
        costs_us = {f"proposals/{name}": round(1e6 * value, 3) for name, value in micro.items()}
        provenance = replace(spec.provenance, metrics={**spec.provenance.metrics, **costs_us})
        return replace(
            spec,
            confidence_threshold=self.threshold,
            uniform_share=self.share,
            passing_share=self.passing,
            provenance=provenance,
        )


def choose_proposals(
    pools: Sequence[Pool], costs: Costs, thresholds: Sequence[float], target_acceptance: float
) -> Choice:
    """The mixture of the least cost among those that are as good as the generator alone.

    Args:
        pools: proposals in validation scenarios.
        costs: of a proposal.
        thresholds: rising; the generator alone is measured at the first, a mixture at the lowest that makes
            it as precise.
        target_acceptance: mean share of all proposals that is to pass, 0 to 1.
    """
    alone = evaluate(pools, costs, 0.0, thresholds[0])
    chosen = (0.0, thresholds[0], alone)
    for share in SHARES[1:]:
        for threshold in thresholds:
            found = evaluate(pools, costs, share, threshold)
            if found.passing.mean() < target_acceptance:
                break
            if found.as_precise_as(alone):
                if found.cost_s < _WORTH * chosen[2].cost_s and found.as_good_as(alone):
                    chosen = (share, threshold, found)
                break
    share, threshold, outcome = chosen
    passing = first_turn(outcome.passing, costs.turn_s / costs.of_one(share))
    return Choice(share, threshold, passing, costs, outcome.cost_s, alone.cost_s)


def first_turn(passing: NDArray[np.float64], turn_rows: float) -> float:
    """What share a first turn had best expect to pass, so that a request takes the least time on average.

    Few proposals make a second turn likely, and many are drawn for nothing.

    Args:
        passing: (scenes,) shares that pass.
        turn_rows: what a second turn costs beside its proposals, in proposals.
    """
    passes = np.maximum(passing, 1.0 / BUDGET)
    needed = ROWS / passes
    found, least = 1.0, np.inf
    for expected in np.unique(passes):
        first = ROWS * (1.0 + EXTRA) / expected
        again = np.where(first < needed, turn_rows + (1.0 + EXTRA) * (needed - first), 0.0)
        rows = first + float(again.mean())
        if rows < least:
            found, least = float(expected), rows
    return found


def evaluate(pools: Sequence[Pool], costs: Costs, share: float, threshold: float) -> Outcome:
    """A mixture at a threshold in all scenes."""
    rows: list[Mapping[str, float] | None] = []
    missing, passing = [], []
    for pool in pools:
        proposals, scored = pool.mixed(share)
        passes = scored.confidence >= threshold
        kept = proposals[passes][:KEPT]
        missing.append(1.0 - len(kept) / KEPT)
        passing.append(float(passes.mean()))
        enough = len(kept) >= _FEWEST
        rows.append(pool.scene.quality(kept.astype(np.float64), pool.held_out) if enough else None)
    has_coverage = bool(pools) and pools[0].scene.measures.coverage_share is not None
    precision, coverage, energy = (
        np.array([nothing if row is None else row[name] for row in rows], dtype=np.float64)
        for name, nothing in (("precision", 1.0), ("coverage", 0.0), ("energy", 0.0))
    )
    shares = np.array(passing)
    # A request draws no more than its budget, however few pass.
    cost_s = float(np.mean((1.0 + EXTRA) * costs.of_one(share) / np.maximum(shares, 1.0 / BUDGET)))
    nothing = np.zeros(len(pools))
    return Outcome(
        precision, coverage if has_coverage else nothing, energy, np.array(missing), shares, cost_s
    )


def proposal_pools(bundle: Bundle, world: World, scenarios: int) -> list[Pool]:
    """Proposals of both kinds in the first validation scenarios."""
    stage = Stage(world, Split.VALIDATION, 0)
    found = []
    for scene in (Scene(stage, index) for index in range(scenarios)):
        picture, seed = bundle.prepare(scene.image), scene.sampler_seed(STREAM)
        generated = bundle.sample(picture, SAMPLED, seed, min_confidence=0.0, report_confidence=False).samples
        uniform = scene.space.to_float32(scene.space.sample_uniform(scene.rng(STREAM), SAMPLED))
        scored = [
            Scored(bundle.score(picture, rows), scene.checker.valid_batch(rows))
            for rows in (generated, uniform)
        ]
        held_out = scene.free(KEPT, scene.rng(STREAM + 2))
        found.append(Pool(scene, held_out, generated, scored[0], uniform, scored[1]))
    return found


def proposal_costs(bundle: Bundle) -> Costs:
    """By the operations of a bundle's graphs, for as many configurations as a request draws."""
    graphs, rng = graphs_of(bundle.folder), np.random.default_rng(0)
    # Which cell a sample starts in decides which network makes it.
    places = {name: rng.random((ROWS, 1), dtype=np.float32) for name in ("cell", "place")}
    learned_s, head_s = (run_cost(graphs[name], ROWS, places) / ROWS for name in ("generator", "validity"))
    turn_s = run_cost(graphs["validity"], 1, {})
    return Costs(learned_s, UNIFORM_ANGLE_S * bundle.spec.dim, head_s, turn_s)
