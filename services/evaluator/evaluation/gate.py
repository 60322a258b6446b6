"""The gate: may a version become the champion?

A version must beat uniform samples beyond the interval and cover the free space; a path model must save a
planner edge checks in narrow passages beyond the interval, and solve no fewer problems. Once there has been a
champion, it must also stay within a fixed margin of the best value that any champion has had, metric by
metric, so that many small steps down can not add up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from services.evaluator.statistics import Interval

PRECISION = "precision"
COVERAGE = "coverage"
EDR = "edr"
PLANNING_SUCCESS = "planning_success"
NARROW_CHECKS = "narrow_edge_checks_ratio"
GATED = (PRECISION, COVERAGE, EDR, PLANNING_SUCCESS)
GATED_PATHS = (PLANNING_SUCCESS, NARROW_CHECKS)
SMALLER_IS_BETTER = frozenset({EDR})

# About ten times the spread between training seeds for precision and coverage, twice for EDr; one margin of
# planning success is six of sixty problems; the factor by which checks are saved is known to about a third.
MARGINS: Mapping[str, float] = MappingProxyType(
    {PRECISION: 0.02, COVERAGE: 0.03, EDR: 0.1, PLANNING_SUCCESS: 0.1, NARROW_CHECKS: 1.0}
)
COVERAGE_FLOOR = 0.8


@dataclass(frozen=True)
class Policy:
    """The fixed numbers of the gate."""

    coverage_floor: float = COVERAGE_FLOOR
    margins: Mapping[str, float] = field(default_factory=lambda: MARGINS)


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
        checks_saved: median edge checks of uniform samples over those of the model's, in narrow problems.
        uniform_success: share of all problems that uniform samples solve.
        metrics: the gated metrics by name.
    """

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


def judge(candidate: Candidate, champions: Sequence[Champion], policy: Policy | None = None) -> Verdict:
    """Decide on a candidate.

    Args:
        candidate: the version under test.
        champions: all earlier champions, oldest first; empty for a first version.
        policy: margins and floor.
    """
    policy = policy or Policy()
    findings = [_beats_uniform(candidate.precision_gain), _covers(candidate, policy)]
    return _verdict(findings, GATED, candidate.metrics, champions, policy)


def judge_paths(
    candidate: PathCandidate, champions: Sequence[Champion], policy: Policy | None = None
) -> Verdict:
    """Decide on a path model; arguments as for :func:`judge`."""
    saved, ours = candidate.checks_saved, candidate.metrics[PLANNING_SUCCESS]
    words = "saves" if saved.low > 1.0 else "does not save"
    less = "no fewer" if ours >= candidate.uniform_success else "fewer"
    findings = [
        _Finding(
            saved.low > 1.0,
            f"{words} edge checks in narrow problems beyond the interval: factor {saved:.2f} over "
            f"{saved.count} problems",
        ),
        _Finding(
            ours >= candidate.uniform_success,
            f"solves {less} problems than uniform samples: {ours:.3f}, {candidate.uniform_success:.3f}",
        ),
    ]
    return _verdict(findings, GATED_PATHS, candidate.metrics, champions, policy or Policy())


def _verdict(
    findings: list[_Finding],
    gated: Sequence[str],
    metrics: Mapping[str, float],
    champions: Sequence[Champion],
    policy: Policy,
) -> Verdict:
    compared = [_compare(name, metrics, champions, policy) for name in gated]
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


def _covers(candidate: Candidate, policy: Policy) -> _Finding:
    value = candidate.metrics[COVERAGE]
    held = value >= policy.coverage_floor
    sign = "at or above" if held else "below"
    return _Finding(held, f"coverage {value:.3f} is {sign} the floor of {policy.coverage_floor:.3f}")


def _compare(
    name: str, metrics: Mapping[str, float], champions: Sequence[Champion], policy: Policy
) -> _Finding | None:
    """Against the best value of all champions; None where none has the metric."""
    having = [champion for champion in champions if name in champion.metrics]
    if not having:
        return None
    sign = -1.0 if name in SMALLER_IS_BETTER else 1.0
    best = max(having, key=lambda champion: sign * champion.metrics[name])
    theirs, margin = best.metrics[name], policy.margins[name]
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
