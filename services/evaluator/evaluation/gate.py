"""The gate: whether a version may become the champion, from paired comparisons with its rivals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.simulator import UNIFORM, Measures
from services.evaluator.evaluation.units import Row
from services.evaluator.measures.planning import PlanningTrial, RunOutcome
from services.evaluator.measures.sample_quality import SampleQuality, SceneQuality
from services.evaluator.statistics import Interval, Statistic, bootstrap_interval, censored_as_largest

SERVED = " as served"
Paired = TypeVar("Paired")


@dataclass(frozen=True, slots=True)
class Gain:
    """One measure of the candidate and of a rival.

    Args:
        name: of the measure.
        ours: the candidate's value.
        theirs: the rival's value.
        gain: the paired difference with its limits; above 0 where the candidate is better.
    """

    name: str
    ours: float
    theirs: float
    gain: Interval

    @property
    def better(self) -> bool:
        """Whether the candidate is better beyond the interval."""
        return self.gain.low > 0.0

    @property
    def worse(self) -> bool:
        """Whether it is worse beyond the interval."""
        return self.gain.high < 0.0

    def __str__(self) -> str:
        return f"{self.name} {self.ours:.4f} against {self.theirs:.4f} (gain {self.gain:+.4f})"


@dataclass(frozen=True, slots=True)
class Comparison:
    """All gated measures of a candidate beside those of a rival, which is named in words."""

    rival: str
    gains: tuple[Gain, ...]


@dataclass(frozen=True, slots=True)
class _Pair:
    """Both on one scene, and uniform samples there."""

    ours: SampleQuality
    theirs: SampleQuality
    uniform: SampleQuality


def compare_samplers(
    rival: str, ours: Sequence[Row], theirs: Sequence[Row], rng: np.random.Generator
) -> Comparison:
    """Precision, coverage, EDr and planning success, as drawn and as served.

    The rows of both are paired by uniform scene and by problem; others are left out.

    Raises:
        EvaluationError: they have no scenes in common.
    """
    scenes, problems = _scenes(ours, theirs), _problems(ours, theirs)
    if not scenes:
        raise EvaluationError("two models are compared on the same scenes", got=f"none with {rival}")
    gains = _quality([_Pair(a.sampler, b.sampler, a.uniform) for a, b in scenes], "", rng)
    gains += _success([(a.learned, b.learned, a) for a, b in problems], "", rng)
    if any(scene.occupancy for pair in scenes for scene in pair):
        served = [(_served(a), _served(b), a.uniform) for a, b in scenes]
        full = [(float(a is not None), float(b is not None)) for a, b, _ in served]
        gains.append(_difference("share of scenes with enough samples" + SERVED, full, rng))
        both = [_Pair(a, b, uniform) for a, b, uniform in served if a is not None and b is not None]
        gains += _quality(both, SERVED, rng) if both else []
        runs = [(a.confident or a.learned, b.confident or b.learned, a) for a, b in problems]
        gains += _success(runs, SERVED, rng)
    return Comparison(rival, tuple(gains))


def compare_paths(
    rival: str, ours: Sequence[Row], theirs: Sequence[Row], decisive: str, rng: np.random.Generator
) -> Comparison:
    """Planning success, and edge checks in the family that tells most; the rest as above."""
    runs = [(a.learned, b.learned, a) for a, b in _problems(ours, theirs)]
    checks = [(a, b) for a, b, trial in runs if trial.family == decisive]
    return Comparison(rival, (*_success(runs, "", rng), _edge_checks(checks, decisive, rng)))


def _scenes(ours: Sequence[Row], theirs: Sequence[Row]) -> list[tuple[SceneQuality, SceneQuality]]:
    return _paired(
        {row.index: row for row in rows if isinstance(row, SceneQuality) and row.family == UNIFORM}
        for rows in (ours, theirs)
    )


def _problems(ours: Sequence[Row], theirs: Sequence[Row]) -> list[tuple[PlanningTrial, PlanningTrial]]:
    return _paired(
        {(row.family, row.index, row.seed): row for row in rows if isinstance(row, PlanningTrial)}
        for rows in (ours, theirs)
    )


def _paired(both: Iterable[Mapping[Any, Paired]]) -> list[tuple[Paired, Paired]]:
    first, second = both
    return [(first[key], second[key]) for key in sorted(first.keys() & second.keys())]


def _served(scene: SceneQuality) -> SampleQuality | None:
    """What the model's users get; None where its head lets too few samples pass."""
    return scene.sampler if scene.occupancy is None else scene.confident


def _quality(pairs: Sequence[_Pair], suffix: str, rng: np.random.Generator) -> list[Gain]:
    gains = [
        _difference(name + suffix, [(getattr(p.ours, name), getattr(p.theirs, name)) for p in pairs], rng)
        for name in ("precision", "coverage")
    ]
    energies = np.array([(p.ours.energy, p.theirs.energy, p.uniform.energy) for p in pairs])
    ours, theirs, uniform = energies.sum(axis=0)
    both = np.array([ours, theirs]) / uniform
    return [*gains, _gain(f"EDr{suffix}", energies, _energy_gain, both, rng)]


def _energy_gain(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    ours, theirs, uniform = np.moveaxis(rows.sum(axis=-2), -1, 0)
    return np.asarray((theirs - ours) / uniform)


def _success(
    runs: Sequence[tuple[RunOutcome, RunOutcome, PlanningTrial]], suffix: str, rng: np.random.Generator
) -> list[Gain]:
    """The mean over the repeats of a problem is one row; nothing where no problem was planned."""
    rows = [(trial.family, trial.index, ours.success, theirs.success) for ours, theirs, trial in runs]
    means = pd.DataFrame(rows).groupby([0, 1], sort=False).mean().to_numpy() if rows else []
    return [_difference(f"planning success{suffix}", means, rng)] if rows else []


def _edge_checks(
    runs: Sequence[tuple[RunOutcome, RunOutcome]], decisive: str, rng: np.random.Generator
) -> Gain:
    flat = [run for pair in runs for run in pair]
    counts = censored_as_largest([run.edge_checks for run in flat], [not run.success for run in flat])
    # One check keeps the ratio finite where a path is found without any.
    table = np.maximum(counts, 1.0).reshape(-1, 2)

    def saved(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        ours, theirs = np.moveaxis(np.median(rows, axis=-2), -1, 0)
        return np.asarray(1.0 - ours / theirs)

    return _gain(f"median edge checks in {decisive} problems", table, saved, np.median(table, axis=0), rng)


def _difference(name: str, pairs: Sequence[Sequence[float]], rng: np.random.Generator) -> Gain:
    table = np.asarray(pairs, dtype=np.float64).reshape(-1, 2)

    def difference(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((rows[..., 0] - rows[..., 1]).mean(axis=-1))

    return _gain(name, table, difference, table.mean(axis=0), rng)


def _gain(
    name: str,
    table: NDArray[np.float64],
    statistic: Statistic,
    both: NDArray[np.float64],
    rng: np.random.Generator,
) -> Gain:
    return Gain(name, float(both[0]), float(both[1]), bootstrap_interval(table, statistic, rng))


# An interval over fewer scenes says nothing about others.
FEWEST_SCENES = 5
COVERAGE = "coverage"
PLANNING_SUCCESS = "planning_success"
SMALLER_IS_BETTER = frozenset({"edr"})


@dataclass(frozen=True)
class Candidate:
    """The estimates of a sampler that decide, from the validation scenarios only.

    Args:
        precision_gain: paired difference in precision to uniform samples.
        real_coverage: coverage of as many real samples on the same scenes.
        metrics: the gated metrics by name; planning success may be missing.
    """

    precision_gain: Interval
    real_coverage: float
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class PathCandidate:
    """The estimates of a path model that decide, from the validation problems only.

    Args:
        decisive: the family of problems that tells most.
        checks_saved: median edge checks of uniform samples over those of the model's, in that family.
        uniform_success: share of all problems that uniform samples solve.
        metrics: the gated metrics by name.
    """

    decisive: str
    checks_saved: Interval
    uniform_success: float
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class Champion:
    """An earlier champion: its version number and the metrics that it was promoted with."""

    version: int
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class Bar:
    """The rivals of a candidate.

    Args:
        comparisons: with rivals that were measured on the same scenes.
        recorded: earlier champions that were not measured again.
        notes: who is left out, and why; what else is known beside the champion.
        against: the number of the present champion, None without one.
    """

    comparisons: tuple[Comparison, ...] = ()
    recorded: tuple[Champion, ...] = ()
    notes: tuple[str, ...] = ()
    against: int | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """The gate's decision, its reasons in words, and what it compared with."""

    promoted: bool
    reasons: tuple[str, ...]
    bar: Bar


# Whether a condition holds, and the reason in words.
_Finding = tuple[bool, str]


def verdict_of(candidate: Candidate, bar: Bar, measures: Measures) -> Verdict:
    """Decide on a candidate, with the share of coverage and the margins of its world."""
    findings, share = [_beats_uniform(candidate.precision_gain)], measures.coverage_share
    if share is not None:
        findings.append(_covers(candidate.metrics[COVERAGE], candidate.real_coverage, share))
    return _verdict(findings, measures.margins, candidate.metrics, bar)


def path_verdict_of(candidate: PathCandidate, bar: Bar, measures: Measures) -> Verdict:
    """Decide on a path model, likewise."""
    saved, ours = candidate.checks_saved, candidate.metrics[PLANNING_SUCCESS]
    saves, as_many = saved.low > 1.0, ours >= candidate.uniform_success
    where = f"edge checks in {candidate.decisive} problems beyond the interval"
    factor = f"factor {saved:.2f} over {saved.count} problems"
    success = f"problems than uniform samples: {ours:.3f}, {candidate.uniform_success:.3f}"
    findings = [
        (saves, f"{'saves' if saves else 'does not save'} {where}: {factor}"),
        (as_many, f"solves {'no fewer' if as_many else 'fewer'} {success}"),
    ]
    return _verdict(findings, measures.path_margins, candidate.metrics, bar)


def _verdict(
    findings: list[_Finding], margins: Mapping[str, float], metrics: Mapping[str, float], bar: Bar
) -> Verdict:
    for comparison in bar.comparisons:
        findings += _beside(comparison)
    for name, margin in margins.items():
        findings += _recorded(name, margin, metrics, bar.recorded)
    findings += [(True, note) for note in bar.notes]
    if not bar.comparisons and not bar.recorded:
        findings.append((True, "there is no earlier champion to compare with"))
    return Verdict(all(held for held, _ in findings), tuple(reason for _, reason in findings), bar)


def _beside(comparison: Comparison) -> list[_Finding]:
    rival, gains = comparison.rival, comparison.gains
    worse = "; ".join(str(gain) for gain in gains if gain.worse)
    better = "; ".join(str(gain) for gain in gains if gain.better)
    if not worse and not better:
        words = "worse in nothing, better in nothing beyond the interval"
        need = "a version has to be better in one measure"
        return [(False, f"only as good as {rival}: {words}; {need}")]
    return [
        (not worse, f"worse than {rival} beyond the interval: {worse or 'in nothing'}"),
        (bool(better), f"better than {rival} beyond the interval: {better or 'in nothing'}"),
    ]


def _beats_uniform(gain: Interval) -> _Finding:
    if gain.count < FEWEST_SCENES:
        return False, f"evaluated on {gain.count} scenes; fewer than {FEWEST_SCENES} say nothing about others"
    held = gain.low > 0.0
    words = "beats uniform beyond the interval" if held else "does not beat uniform beyond the interval"
    return held, f"precision {words}: gain {gain:+.3f} over {gain.count} scenarios"


def _covers(value: float, real: float, share: float) -> _Finding:
    held = value >= share * real
    sign = "at least" if held else "less than"
    return held, f"coverage {value:.3f} is {sign} {share:.2f} of the {real:.3f} of real samples"


def _recorded(
    name: str, margin: float, metrics: Mapping[str, float], champions: Sequence[Champion]
) -> list[_Finding]:
    """Against the best recorded value; nothing where no champion has the metric."""
    sign = -1.0 if name in SMALLER_IS_BETTER else 1.0
    having = [champion for champion in champions if name in champion.metrics]
    if not having:
        return []
    best = max(having, key=lambda champion: sign * champion.metrics[name])
    theirs = best.metrics[name]
    if name not in metrics:
        return [(False, f"{name} was not measured; version {best.version} has {theirs:.3f}")]
    held = sign * (metrics[name] - theirs) >= -margin
    margins = f"{'is within' if held else 'is worse than'} the margin of {margin:.3f}"
    of = f"of the {theirs:.3f} recorded of version {best.version}"
    return [(held, f"{name} {metrics[name]:.3f} {margins} {of}")]
