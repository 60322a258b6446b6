"""The gate: may a version become the champion?

A version must beat uniform samples beyond the interval, on five scenes or more, and cover most of what real
samples cover; a path model must save a planner edge checks beyond the interval in the problems that tell
most, and solve no fewer problems. Beside every rival, measured on the same scenes, it must be worse in no
gated measure beyond the interval, and better in one. A champion that was not measured again is compared by
its recorded metrics, each with a fixed margin; as the best of them counts, many small steps down can not add
up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cspace.workshop import Measures
from services.evaluator.evaluation.comparison import Comparison
from services.evaluator.statistics import Interval

# What an interval over fewer says of scenes that nobody has seen is nothing.
FEWEST_SCENES = 5
COVERAGE = "coverage"
PLANNING_SUCCESS = "planning_success"
SMALLER_IS_BETTER = frozenset({"edr"})


@dataclass(frozen=True)
class Candidate:
    """What the gate looks at, from the validation scenarios only.

    Args:
        precision_gain: paired difference in precision to uniform samples.
        real_coverage: what as many real samples cover of the same scenes.
        metrics: the gated metrics by name; planning success may be missing.
    """

    precision_gain: Interval
    real_coverage: float
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class PathCandidate:
    """What the gate looks at of a path model, from the validation problems only.

    Args:
        telling: the family of problems that tells most.
        checks_saved: median edge checks of uniform samples over those of the model's, in that family.
        uniform_success: share of all problems that uniform samples solve.
        metrics: the gated metrics by name.
    """

    telling: str
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
    """Whom a candidate is compared with.

    Args:
        comparisons: with rivals that were measured beside it.
        recorded: earlier champions that were not.
        notes: who is left out, and why.
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


@dataclass(frozen=True, slots=True)
class _Finding:
    held: bool
    reason: str


def judge(candidate: Candidate, bar: Bar, measures: Measures) -> Verdict:
    """Decide on a candidate.

    Args:
        candidate: the version under test.
        bar: whom it is compared with.
        measures: the world's share of coverage and margins.
    """
    findings, share = [_beats_uniform(candidate.precision_gain)], measures.coverage_share
    if share is not None:
        findings.append(_covers(candidate.metrics[COVERAGE], candidate.real_coverage, share))
    return _verdict(findings, measures.margins, candidate.metrics, bar)


def judge_paths(candidate: PathCandidate, bar: Bar, measures: Measures) -> Verdict:
    """Decide on a path model; arguments as for :func:`judge`."""
    saved, ours = candidate.checks_saved, candidate.metrics[PLANNING_SUCCESS]
    words = "saves" if saved.low > 1.0 else "does not save"
    less = "no fewer" if ours >= candidate.uniform_success else "fewer"
    findings = [
        _Finding(
            saved.low > 1.0,
            f"{words} edge checks in {candidate.telling} problems beyond the interval: factor {saved:.2f} "
            f"over {saved.count} problems",
        ),
        _Finding(
            ours >= candidate.uniform_success,
            f"solves {less} problems than uniform samples: {ours:.3f}, {candidate.uniform_success:.3f}",
        ),
    ]
    return _verdict(findings, measures.path_margins, candidate.metrics, bar)


def _verdict(
    findings: list[_Finding], margins: Mapping[str, float], metrics: Mapping[str, float], bar: Bar
) -> Verdict:
    for comparison in bar.comparisons:
        findings += _beside(comparison)
    recorded = [_compare(name, margin, metrics, bar.recorded) for name, margin in margins.items()]
    findings += [finding for finding in recorded if finding is not None]
    findings += [_Finding(held=True, reason=note) for note in bar.notes]
    if not bar.comparisons and not bar.recorded:
        findings.append(_Finding(held=True, reason="there is no earlier champion to compare with"))
    held = all(finding.held for finding in findings)
    return Verdict(held, tuple(finding.reason for finding in findings), bar)


def _beside(comparison: Comparison) -> tuple[_Finding, ...]:
    rival, gains = comparison.rival, comparison.gains
    worse = [str(gain) for gain in gains if gain.worse]
    better = [str(gain) for gain in gains if gain.better]
    if not worse and not better:
        words = "worse in nothing, better in nothing beyond the interval"
        need = "a version has to be better in one measure"
        return (_Finding(held=False, reason=f"only as good as {rival}: {words}; {need}"),)
    return (
        _Finding(not worse, f"worse than {rival} beyond the interval: {'; '.join(worse) or 'in nothing'}"),
        _Finding(
            bool(better), f"better than {rival} beyond the interval: {'; '.join(better) or 'in nothing'}"
        ),
    )


def _beats_uniform(gain: Interval) -> _Finding:
    if gain.count < FEWEST_SCENES:
        told = f"judged on {gain.count} scenes; fewer than {FEWEST_SCENES} tell nothing of others"
        return _Finding(held=False, reason=told)
    held = gain.low > 0.0
    words = "beats uniform beyond the interval" if held else "does not beat uniform beyond the interval"
    return _Finding(held, f"precision {words}: gain {gain:+.3f} over {gain.count} scenarios")


def _covers(value: float, real: float, share: float) -> _Finding:
    held = value >= share * real
    sign = "at least" if held else "less than"
    return _Finding(held, f"coverage {value:.3f} is {sign} {share:.2f} of the {real:.3f} of real samples")


def _compare(
    name: str, margin: float, metrics: Mapping[str, float], champions: Sequence[Champion]
) -> _Finding | None:
    """Against the best recorded value; None where no champion has the metric."""
    having = [champion for champion in champions if name in champion.metrics]
    if not having:
        return None
    sign = -1.0 if name in SMALLER_IS_BETTER else 1.0
    best = max(having, key=lambda champion: sign * champion.metrics[name])
    theirs = best.metrics[name]
    if name not in metrics:
        return _Finding(
            held=False, reason=f"{name} was not measured; version {best.version} has {theirs:.3f}"
        )
    ours = metrics[name]
    held = sign * (ours - theirs) >= -margin
    words = "is within" if held else "is worse than"
    return _Finding(
        held,
        f"{name} {ours:.3f} {words} the margin of {margin:.3f} of the {theirs:.3f} recorded of version "
        f"{best.version}",
    )
