"""The gate: whether a version may become the champion, from paired comparisons with its rivals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from cspace.errors import EvaluationError
from cspace.simulator import UNIFORM, Measures
from cspace.worlds import simulator_of
from services.evaluator.evaluation import VALIDATION, Evaluation, run_metrics
from services.evaluator.metrics import Task
from services.evaluator.statistics import (
    Floats,
    Interval,
    Statistic,
    bootstrap_interval,
    censored_as_largest,
    summary_rng,
)

SERVED = " as served"
# An interval over fewer scenes says nothing about others.
FEWEST_SCENES = 5
SMALLER_IS_BETTER = frozenset({"edr"})


@dataclass(frozen=True, slots=True)
class Gain:
    """One measure of the candidate and of a rival; ``gain`` is above 0 where the candidate is better."""

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


@dataclass(frozen=True)
class Champion:
    """An earlier champion: its version number and the metrics that it was promoted with."""

    version: int
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class Bar:
    """The rivals of a candidate, measured on the same scenes or ``recorded`` when they were promoted.

    ``notes`` says who is left out and why; ``against`` is the number of the present champion.
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


def compare(evaluation: Evaluation, rival: str) -> Comparison:
    """The model of an evaluation and a rival in its table, paired by validation scene and problem.

    Samplers are compared by precision, coverage, EDr and planning success, as drawn and as served. Path
    models are compared by planning success, and by edge checks in the decisive family.
    """
    rng, setting = summary_rng(evaluation.setting.seed), evaluation.setting
    models = (evaluation.model, rival)
    runs = _paired([_wide(evaluation.select(VALIDATION, Task.PLANNING, one)) for one in models])
    if setting.paths:
        decisive = simulator_of(setting.world).families.decisive
        return Comparison(rival, (*_success(runs, "learned", "", rng), _edge_checks(runs, decisive, rng)))
    selected = [evaluation.select(VALIDATION, Task.RECONSTRUCTION, one) for one in models]
    scenes = _paired([_wide(one[one["family"] == UNIFORM]) for one in selected])
    if scenes[0].empty:
        raise EvaluationError("two models are compared on the same scenes", got=f"none with {rival}")
    uniform = scenes[0]["uniform", "energy"]
    gains = _quality([one["sampler"] for one in scenes], uniform, "", rng)
    gains += _success(runs, "learned", "", rng)
    heads = [not evaluation.select(VALIDATION, Task.HEAD, one).empty for one in models]
    if any(heads):
        # Users get the samples that a head accepts; in some scenes it may accept too few.
        served = [
            _of(one, "confident") if head else one["sampler"] for one, head in zip(scenes, heads, strict=True)
        ]
        full = [one["precision"].notna() for one in served]
        gains.append(_difference("share of scenes with enough samples" + SERVED, full, rng))
        both = full[0] & full[1]
        gains += _quality([one[both] for one in served], uniform[both], SERVED, rng) if both.any() else []
        gains += _success(runs, "confident", SERVED, rng)
    return Comparison(rival, tuple(gains))


Pair = Sequence[pd.DataFrame]


def _wide(rows: pd.DataFrame) -> pd.DataFrame:
    """One row a scene or run, columns (sampler, metric)."""
    first = rows[rows["part"] == 0]
    return first.pivot(index=["family", "number", "seed"], columns=["sampler", "metric"], values="value")


def _paired(both: Pair) -> Pair:
    common = both[0].index.intersection(both[1].index).sort_values()
    return [one.loc[common] for one in both]


def _of(wide: pd.DataFrame, sampler: str) -> pd.DataFrame:
    there = sampler in wide.columns.get_level_values("sampler")
    return wide[sampler] if there else wide["sampler"] * np.nan


def _quality(both: Pair, uniform: pd.Series, suffix: str, rng: np.random.Generator) -> list[Gain]:
    gains = [
        _difference(name + suffix, [one[name] for one in both], rng) for name in ("precision", "coverage")
    ]
    energies = np.column_stack([*(one["energy"] for one in both), uniform])
    ratios = energies[:, :2].sum(axis=0) / energies[:, 2].sum()

    def saved(rows: Floats) -> Floats:
        ours, theirs, reference = np.moveaxis(rows.sum(axis=-2), -1, 0)
        return np.asarray((theirs - ours) / reference)

    return [*gains, _gain(f"EDr{suffix}", energies, saved, ratios, rng)]


def _success(runs: Pair, sampler: str, suffix: str, rng: np.random.Generator) -> list[Gain]:
    """The mean over the repeats of a problem is one row; nothing where no problem was planned."""
    if runs[0].empty:
        return []
    found = []
    for one in runs:
        column, drawn = (sampler, "success"), one["learned", "success"]
        solved = one[column].fillna(drawn) if column in one.columns else drawn
        found.append(solved.groupby(["family", "number"], sort=False).mean())
    return [_difference(f"planning success{suffix}", found, rng)]


def _edge_checks(runs: Pair, decisive: str, rng: np.random.Generator) -> Gain:
    mine = [one["learned"][one.index.get_level_values("family") == decisive] for one in runs]
    checks, solved = (np.column_stack([one[name] for one in mine]) for name in ("edge_checks", "success"))
    # One check keeps the ratio finite where a path is found without any.
    table = np.maximum(censored_as_largest(checks, solved == 0.0), 1.0)

    def saved(rows: Floats) -> Floats:
        ours, theirs = np.moveaxis(np.median(rows, axis=-2), -1, 0)
        return np.asarray(1.0 - ours / theirs)

    return _gain(f"median edge checks in {decisive} problems", table, saved, np.median(table, axis=0), rng)


def _difference(name: str, both: Sequence[pd.Series], rng: np.random.Generator) -> Gain:
    table = np.column_stack(both).astype(np.float64)

    def difference(rows: Floats) -> Floats:
        return np.asarray((rows[..., 0] - rows[..., 1]).mean(axis=-1))

    return _gain(name, table, difference, table.mean(axis=0), rng)


def _gain(name: str, table: Floats, statistic: Statistic, both: Floats, rng: np.random.Generator) -> Gain:
    return Gain(name, float(both[0]), float(both[1]), bootstrap_interval(table, statistic, rng))


# Whether a condition holds, and the reason in words.
_Finding = tuple[bool, str]


def decide(evaluation: Evaluation, bar: Bar) -> Verdict:
    """Decide on a model, with the share of coverage and the margins of its world."""
    measures, metrics = simulator_of(evaluation.setting.world).measures, gated_metrics(evaluation)
    findings = _path_findings(evaluation) if evaluation.setting.paths else _findings(evaluation, measures)
    for comparison in bar.comparisons:
        findings += _beside(comparison)
    for name, margin in _margins(evaluation).items():
        findings += _recorded(name, margin, metrics, bar.recorded)
    findings += [(True, note) for note in bar.notes]
    if not bar.comparisons and not bar.recorded:
        findings.append((True, "there is no earlier champion to compare with"))
    return Verdict(all(held for held, _ in findings), tuple(reason for _, reason in findings), bar)


def gated_metrics(evaluation: Evaluation) -> dict[str, float]:
    """The metrics that a decision records; planning success may be missing."""
    metrics = run_metrics(evaluation)
    logged = {
        name: f"{VALIDATION}/{name.replace('_edge_checks_ratio', '/edge_checks_saved')}"
        for name in _margins(evaluation)
    }
    return {name: metrics[key] for name, key in logged.items() if key in metrics}


def _margins(evaluation: Evaluation) -> Mapping[str, float]:
    measures = simulator_of(evaluation.setting.world).measures
    return measures.path_margins if evaluation.setting.paths else measures.margins


def _findings(evaluation: Evaluation, measures: Measures) -> list[_Finding]:
    gain = evaluation.estimate("precision_gain", "sampler", UNIFORM)
    coverage, real = (evaluation.estimate("coverage", one, UNIFORM) for one in ("sampler", "real"))
    if gain is None or coverage is None or real is None:
        raise EvaluationError("samplers are evaluated on uniform scenes", expected="one or more", got="none")
    findings, share = [_beats_uniform(gain)], measures.coverage_share
    if share is not None:
        held = coverage.estimate >= share * real.estimate
        sign = "at least" if held else "less than"
        of = f"{share:.2f} of the {real.estimate:.3f} of real samples"
        findings.append((held, f"coverage {coverage.estimate:.3f} is {sign} {of}"))
    return findings


def _beats_uniform(gain: Interval) -> _Finding:
    if gain.count < FEWEST_SCENES:
        return False, f"evaluated on {gain.count} scenes; fewer than {FEWEST_SCENES} say nothing about others"
    held = gain.low > 0.0
    words = "beats uniform beyond the interval" if held else "does not beat uniform beyond the interval"
    return held, f"precision {words}: gain {gain:+.3f} over {gain.count} scenarios"


def _path_findings(evaluation: Evaluation) -> list[_Finding]:
    decisive = simulator_of(evaluation.setting.world).families.decisive
    saved = evaluation.estimate("edge_checks_ratio", "learned", decisive)
    ours, uniform = (evaluation.estimate("success", one, "") for one in ("learned", "uniform"))
    if saved is None or ours is None or uniform is None:
        raise EvaluationError(
            f"path models are evaluated on {decisive} problems", expected="one or more", got="none"
        )
    saves, as_many = saved.low > 1.0, ours.estimate >= uniform.estimate
    where = f"edge checks in {decisive} problems beyond the interval"
    factor = f"factor {saved:.2f} over {saved.count} problems"
    success = f"problems than uniform samples: {ours.estimate:.3f}, {uniform.estimate:.3f}"
    return [
        (saves, f"{'saves' if saves else 'does not save'} {where}: {factor}"),
        (as_many, f"solves {'no fewer' if as_many else 'fewer'} {success}"),
    ]


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
