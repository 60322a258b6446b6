"""What a bundle states of itself, fitted to validation scenes: threshold, conformal bound, plans, novelty."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cspace.bundle import Bundle, BundleSpec
from cspace.bundle.load import quantiles_of
from cspace.bundle.sampling import UNIFORM_SHARE
from cspace.dataset import Dataset
from cspace.errors import ImageError, ScenarioError
from cspace.planning.cost import calibration_error, confidence_of_cost, fit_calibration
from cspace.planning.paths import spaced
from cspace.query import PlanQuery
from cspace.simulator import Split
from cspace.world import World
from cspace.worlds import checker_of, picture_file_of, simulator_of
from services.evaluator.scenes import Scene, Stage
from training.config import VaeConfig
from training.models.autoencoders import blocks, load_encoder

_LOG = logging.getLogger(__name__)


KNOWN_PICTURES = 400


def known_quantiles(
    config: VaeConfig, checkpoint: Path, scores: nn.Module, dataset: Dataset
) -> tuple[tuple[float, ...], ...]:
    """Quantiles of both scores over pictures of the kind that the VAE was trained on.

    Where the scenarios were generated these are validation scenarios; with data of one's own, of which
    there are no others, they are the pictures of the data set, and the percentiles a little too high.
    """
    images, sensor = known_pictures(dataset), dataset.world.sensor
    encoder = load_encoder(config, sensor, checkpoint)
    found = []
    with torch.inference_mode():
        for rows in blocks(sensor, len(images)):
            pictures = torch.from_numpy(sensor.to_network(images[rows]))
            found.append(scores(pictures, encoder(pictures)[0]).numpy())
    return quantiles_of(np.concatenate(found))


def known_pictures(dataset: Dataset) -> NDArray[np.uint8]:
    """At most 400 pictures (n, P, P, 3)."""
    simulator = simulator_of(dataset.world)
    if dataset.generator_seed is None or simulator.count(Split.VALIDATION) is not None:
        rows = np.linspace(0, dataset.scenario_count - 1, min(KNOWN_PICTURES, dataset.scenario_count))
        return np.array(dataset.images[rows.astype(np.int64)])
    scenes = simulator.scenes(Split.VALIDATION, 0, KNOWN_PICTURES)
    return np.stack([simulator.render(scene) for scene in scenes])


# Of a scene's seeds, apart from those that the evaluator's measurements use.
STREAM = 45
CANDIDATES = tuple(round(0.5 + 0.05 * step, 2) for step in range(10))


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """Configurations in one scenario."""

    confidence: NDArray[np.floating]  # (n,) by the validity head
    free: NDArray[np.bool_]  # (n,) whether each is

    def passing(self, threshold: float) -> tuple[float, float]:
        """Shares of all: what reaches the threshold, and what reaches it and is free."""
        passes = self.confidence >= threshold
        return float(np.mean(passes)), float(np.mean(passes & self.free))


def choose_threshold(
    proposed: Sequence[Scored], target_precision: float, candidates: Sequence[float] = CANDIDATES
) -> float:
    """The lowest candidate at which the samples that pass are as precise as wanted.

    Both the mean over scenarios and their 10th percentile count, for a sampler that is right on average may
    fail one scenario in ten; the percentile may miss as much again as the mean.

    Returns:
        The threshold; the highest candidate where none is enough.
    """
    low = 1.0 - 2.0 * (1.0 - target_precision)
    for threshold in candidates:
        passing = np.array([rows.passing(threshold) for rows in proposed])
        if not passing[:, 0].all():
            break
        precisions = passing[:, 1] / passing[:, 0]
        if precisions.mean() >= target_precision and np.quantile(precisions, 0.1) >= low:
            return threshold
    return candidates[-1]


def validation_scores(
    bundle: Bundle, world: World, scenarios: int, samples: int = 1000
) -> tuple[list[Scored], list[Scored]]:
    """A bundle's proposals and uniform ones in validation scenarios, as its head scores them.

    The proposals are those of a request that filters: the generator's, and uniform ones in their share.
    """
    stage = Stage(world, Split.VALIDATION, 0)
    proposed: list[Scored] = []
    uniform: list[Scored] = []
    for scene in (Scene(stage, index) for index in range(scenarios)):
        picture = bundle.prepare(scene.image)
        generated = bundle.sample(picture, samples, scene.sampler_seed(STREAM), min_confidence=0.0).samples
        anywhere = scene.space.to_float32(scene.space.sample_uniform(scene.rng(STREAM), samples))
        few = round(UNIFORM_SHARE * samples)
        mixed = np.concatenate([generated[few:], anywhere[:few]])
        for group, rows in ((proposed, mixed), (uniform, anywhere)):
            group.append(Scored(bundle.predict(picture, rows)[0], scene.checker.valid_batch(rows)))
    return proposed, uniform


FINE = (*CANDIDATES, 0.96, 0.97, 0.98, 0.99)
# Of scenes, whose risk the second statement bounds.
MOST = 0.9


def choose_bounded(scenes: Sequence[Scored], at_most: float) -> float:
    """The lowest threshold whose bound is small enough, by the scenes that choose.

    Returns:
        The highest threshold where none is low enough.
    """
    choosing = scenes[::3]
    return next((one for one in FINE if _bound(_risks(choosing, one)) <= at_most), FINE[-1])


def collision_bound(scenes: Sequence[Scored], threshold: float) -> dict[str, float]:
    """What holds at a threshold that the other scenes decided nothing of, and what was measured there."""
    made, others = np.sort(_risks(scenes[1::3], threshold)), _risks(scenes[2::3], threshold)
    place = math.ceil((len(made) + 1) * MOST)
    in_most = float(made[place - 1]) if place <= len(made) else 1.0
    return {
        "at_most": _bound(made),
        "at_most_in_nine_of_ten_scenes": in_most,
        "scenes": float(len(made)),
        "measured": float(others.mean()),
        "measured_violations": float(np.mean(others > in_most)),
        "measured_scenes": float(len(others)),
    }


def _bound(risks: NDArray[np.float64]) -> float:
    return (float(risks.sum()) + 1.0) / (len(risks) + 1)


def _risks(scenes: Sequence[Scored], threshold: float) -> NDArray[np.float64]:
    """(scenes,): shares of what passes that collide; 0 where nothing passes."""
    shares = [one.passing(threshold) for one in scenes]
    return np.array([1.0 - free / passing if passing else 0.0 for passing, free in shares])


# Of problems, apart from those that the evaluator draws.
SEED = 46
# Paths are checked at half of the resolution of planners.
_FINER = 0.5
# Of a fit for a number of pictures, at that for all: 20 plans weigh about as much.
_PRIOR = 10.0
_FOLDS = 3


@dataclass(frozen=True, slots=True)
class Planned:
    """The best paths of validation problems."""

    cost: NDArray[np.float64]  # (n,) of each, see :mod:`cspace.planning.cost`
    free: NDArray[np.bool_]  # (n,) whether it is collision-free, by the ground truth
    pictures: NDArray[np.int64]  # (n,) that its scene was seen by

    def among(self, rows: NDArray[np.bool_]) -> "Planned":
        """Those of some rows (n,)."""
        return Planned(self.cost[rows], self.free[rows], self.pictures[rows])


@dataclass(frozen=True, slots=True)
class PlanCalibration:
    """What was fitted, and how well such fits predict plans that had no part in them, each third in turn."""

    parameters: tuple[tuple[float, float], ...]  # (a, b) for one picture, two and so on
    metrics: Mapping[str, float]

    def stated_in(self, spec: BundleSpec) -> BundleSpec:
        """A bundle's description with what was fitted."""
        provenance = replace(spec.provenance, metrics={**spec.provenance.metrics, **self.metrics})
        return replace(spec, plan_calibration=self.parameters, provenance=provenance)


def planned(bundle: Bundle, world: World, problems: int) -> Planned:
    """Plan in so many validation problems, of all solvable families in turn, and check the paths.

    Searches end by their own effort and not by a clock, so that the same seed gives the same bundle.
    """
    simulator = simulator_of(world)
    families, measures = simulator.families.solvable, simulator.measures
    costs, free, pictures = [], [], []
    for number in range(problems):
        family, index = families[number % len(families)], number // len(families)
        try:
            problem = simulator.problem(family, Split.VALIDATION, SEED, index)
            read = world.examine_picture(picture_file_of(problem.scenario))
        except (ImageError, ScenarioError) as error:
            # An arm of few joints reaches into no shelf, and a camera may look past a small arm's reach.
            _LOG.warning("plans: %s", error.what)
            continue
        start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
        query = PlanQuery(start, goal, number, 0.0, math.inf)
        found = bundle.plan(bundle.prepare(read), query)
        if not len(found.path):
            continue
        states = spaced(found.path, world.space, _FINER * measures.resolution_rad)
        costs.append(found.cost)
        free.append(bool(checker_of(problem.scenario).valid_batch(states).all()))
        pictures.append(read.pictures)
    return Planned(np.array(costs, np.float64), np.array(free, np.bool_), np.array(pictures, np.int64))


def fit_plan_calibration(plans: Planned) -> PlanCalibration | None:
    """Fit, and measure; None where there are too few plans to say anything."""
    fold = np.arange(len(plans.cost)) % _FOLDS
    if len(fold) < _FOLDS:
        return None
    predicted = np.empty(len(fold))
    for number in range(_FOLDS):
        others = fold == number
        predicted[others] = _confidence(plans.among(others), _fitted(plans.among(~others)))
    metrics = {
        "plans/fitted": float(len(fold)),
        "plans/collide": float(1.0 - plans.free.mean()),
        "plans/calibration_error": calibration_error(predicted, plans.free),
    }
    return PlanCalibration(_fitted(plans), metrics)


def _fitted(plans: Planned) -> tuple[tuple[float, float], ...]:
    usual = fit_calibration(plans.cost, plans.free)
    each = [plans.among(plans.pictures == number) for number in range(1, int(plans.pictures.max()) + 1)]
    return tuple(fit_calibration(one.cost, one.free, _PRIOR, usual) for one in each)


def _confidence(plans: Planned, parameters: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    places = np.minimum(plans.pictures, len(parameters)) - 1
    found = [confidence_of_cost(plans.cost, one) for one in parameters]
    return np.asarray(np.array(found)[places, np.arange(len(places))], dtype=np.float64)
