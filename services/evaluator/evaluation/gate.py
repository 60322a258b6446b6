"""The gate: may a version become the champion?

A version must beat uniform samples beyond the interval and cover the free space; a path model must save a
planner edge checks beyond the interval in the problems that tell most, and solve no fewer problems. Once
there has been a champion, it must also stay within a fixed margin of the best value that any champion has
had, metric by metric, so that many small steps down can not add up. Floor and margins are the world's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cspace.workshop import Measures
from services.evaluator.statistics import Interval

COVERAGE = "coverage"
PLANNING_SUCCESS = "planning_success"
SMALLER_IS_BETTER = frozenset({"edr"})


@dataclass(frozen=True)
class Candidate:
    """What the gate looks at, from the validation scenarios only.

    Args:
        precision_gain: paired difference in precision to uniform samples.
        metrics: the gated metrics by name; planning success may be missing.
    """

    precision_gain: Interval
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


@dataclass(frozen=True, slots=True)
class Verdict:
    """The gate's decision, its reasons in words, and the version of the latest champion if there was one."""

    promoted: bool
    reasons: tuple[str, ...]
    against: int | None


@dataclass(frozen=True, slots=True)
class _Finding:
    held: bool
    reason: str


def judge(candidate: Candidate, champions: Sequence[Champion], measures: Measures) -> Verdict:
    """Decide on a candidate.

    Args:
        candidate: the version under test.
        champions: all earlier champions, oldest first; empty for a first version.
        measures: the world's margins and floor.
    """
    findings = [
        _beats_uniform(candidate.precision_gain),
        _covers(candidate.metrics[COVERAGE], measures.coverage_floor),
    ]
    return _verdict(findings, measures.margins, candidate.metrics, champions)


def judge_paths(candidate: PathCandidate, champions: Sequence[Champion], measures: Measures) -> Verdict:
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
    return _verdict(findings, measures.path_margins, candidate.metrics, champions)


def _verdict(
    findings: list[_Finding],
    margins: Mapping[str, float],
    metrics: Mapping[str, float],
    champions: Sequence[Champion],
) -> Verdict:
    compared = [_compare(name, margin, metrics, champions) for name, margin in margins.items()]
    findings = [*findings, *(finding for finding in compared if finding is not None)]
    if not champions:
        findings.append(_Finding(held=True, reason="there is no earlier champion to compare with"))
    held = all(finding.held for finding in findings)
    return Verdict(
        held, tuple(finding.reason for finding in findings), champions[-1].version if champions else None
    )


def _beats_uniform(gain: Interval) -> _Finding:
    held = gain.low > 0.0
    words = "beats uniform beyond the interval" if held else "does not beat uniform beyond the interval"
    return _Finding(held, f"precision {words}: gain {gain:+.3f} over {gain.count} scenarios")


def _covers(value: float, floor: float) -> _Finding:
    held = value >= floor
    sign = "at or above" if held else "below"
    return _Finding(held, f"coverage {value:.3f} is {sign} the floor of {floor:.3f}")


def _compare(
    name: str, margin: float, metrics: Mapping[str, float], champions: Sequence[Champion]
) -> _Finding | None:
    """Against the best value of all champions; None where none has the metric."""
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
        held, f"{name} {ours:.3f} {words} the margin of {margin:.3f} of version {best.version}'s {theirs:.3f}"
    )
