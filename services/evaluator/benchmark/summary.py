"""Runs reduced to a long table of figures with intervals: a row for each group of problems, arm and measure.

Intervals are 95 % limits: exact (Clopper-Pearson) for shares, by bootstrap over problems for the rest. A run
without success ranks behind all others; a quantile among such runs is a lower bound, and its upper limit is
infinite.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from cspace.errors import EvaluationError
from cspace.planning.cost import calibration_error
from cspace.simulator import Taken as Unseen
from cspace.worlds import partly_seen
from services.evaluator.benchmark.arms import CONNECT, Arm, Group, PlanArm, Setting, plain_arm
from services.evaluator.benchmark.plans import NO_PROBLEM
from services.evaluator.statistics import (
    CONFIDENCE,
    Interval,
    bootstrap_interval,
    censored_as_largest,
    clopper_pearson,
    difference_interval,
    mean_interval,
    quantile_interval,
    ratio_of_sums_interval,
)
from services.planner.result import Reason
from services.planner.settings import RRT_CONNECT, SAMPLED_CONNECT

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
# A measure's name and its estimate; a plain number has no limits.
Measure = tuple[str, Interval | float | None]

COLUMNS = ("family", "arm", "measure", "value", "low", "high", "count")
WITHIN_COUNTS = (100, 300, 1000)
WITHIN = WITHIN_COUNTS[-1]
PARTS = ("request", "server", "transport", "check")
RESAMPLES = 2000
# A path is as good as the best one where it is at most this much longer.
CLOSE = 1.05
DEEP_M = 0.01
# Bins of the unseen share along a path; most paths have nearly all of the arm there.
UNSEEN_EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)
HARD = "the hard ones"
# Two programs of one algorithm.
_SAME = {SAMPLED_CONNECT: RRT_CONNECT}


class Paired:
    """Runs of a group of problems, with every arm on the same problems equally often.

    Problems that an arm has not run are left out, as are those with fewer runs than others.

    Args:
        runs: a table of runs, one row each.

    Raises:
        EvaluationError: no problem was run by all arms.
    """

    def __init__(self, runs: pd.DataFrame) -> None:
        arms = runs.groupby(["family", "problem", "run"])["arm"].nunique()
        shared = arms[arms == runs["arm"].nunique()]
        each = shared.groupby(level=["family", "problem"]).transform("size")
        kept = shared[each == each.max()].index
        if kept.empty:
            raise EvaluationError("no problem was run by all arms", expected="one or more", got="none")
        self.runs = runs.set_index(kept.names).loc[kept].reset_index()
        self.arms = list(dict.fromkeys(self.runs["arm"]))
        self.repeats = int(each.max())
        self.problems = len(kept) // self.repeats
        self._by_arm = {str(arm): own for arm, own in self.runs.groupby("arm")}

    def of(self, arm: str) -> pd.DataFrame:
        """The runs of an arm, problem by problem.

        Raises:
            EvaluationError: there is no such arm.
        """
        if arm not in self._by_arm:
            raise EvaluationError("there is no such arm", expected=", ".join(self.arms), got=arm)
        return self._by_arm[arm]

    def values(self, arm: str, column: str) -> Floats:
        """(P, R) values of a column; nan where a run has none."""
        found: Floats = self.of(arm)[column].to_numpy(dtype=np.float64, na_value=np.nan)
        return found.reshape(self.problems, self.repeats)

    def solved(self, arm: str) -> Flags:
        """(P, R) whether a run succeeded."""
        return self.values(arm, "solved").astype(bool)


def summary_table(figures: Iterable[tuple[str, str, Measure]]) -> pd.DataFrame:
    """The long table of groups, arms and measures, without those that have no value."""
    rows = []
    for family, arm, (name, value) in figures:
        if isinstance(value, Interval):
            rows.append((family, arm, name, value.estimate, value.low, value.high, value.count))
        elif value is not None:
            rows.append((family, arm, name, value, math.nan, math.nan, 0))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def metric_name(name: str) -> str:
    """A name as a part of a metric's."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name.replace("*", "star")).strip("_")


def metrics(summary: pd.DataFrame, measures: Sequence[str]) -> dict[str, float]:
    """Finite values of some measures as metrics, as in ``narrow/RRT_path_70/iterations_ratio_median``."""
    found = summary[summary["measure"].isin(measures) & np.isfinite(summary["value"])]
    names = found["family"].map(metric_name) + "/" + found["arm"].map(metric_name) + "/" + found["measure"]
    return dict(zip(names, found["value"].astype(float), strict=True))


def _quantiles(name: str, values: Floats, failed: Flags, scale: float = 1.0) -> Iterator[Measure]:
    """Median and 90th percentile of runs; one that is only a lower bound has no upper limit."""
    found = summarise_censored(values.ravel(), failed.ravel())
    for what in ("median", "p90"):
        value, is_bound = scale * getattr(found, what), getattr(found, f"{what}_is_bound")
        yield f"{name}_{what}", Interval(value, value, math.inf if is_bound else value, found.count)


def ratios(
    name: str, values: Floats, failed: Flags, base: Floats, base_failed: Flags, rng: np.random.Generator
) -> Iterator[Measure]:
    """Median and 90th percentile over those of a base, with intervals over problems.

    All arrays are (P, R), of the same problems; a run that failed ranks behind all runs of both.
    """
    both, cut = np.stack([values, base], axis=-1), np.stack([failed, base_failed], axis=-1)
    # A direct connection takes no iteration to speak of; one unit keeps the ratio finite.
    ranked = np.maximum(censored_as_largest(both.ravel(), cut.ravel()), 1.0)
    rows = ranked.reshape(len(values), -1)
    for what, quantile in (("median", 0.5), ("p90", 0.9)):

        def quotient(rows: Floats, quantile: float = quantile) -> Floats:
            # (..., P, 2 R): a problem's runs of both arms, pair by pair.
            both = np.quantile(rows.reshape(*rows.shape[:-2], -1, 2), quantile, axis=-2)
            return np.asarray(both[..., 0] / both[..., 1])

        yield f"{name}_{what}", bootstrap_interval(rows, quotient, rng, resamples=RESAMPLES)


def _arm_ratios(
    name: str, paired: Paired, arm: str, base: str, column: str, rng: np.random.Generator
) -> Iterator[Measure]:
    failed, base_failed = (~paired.solved(one) for one in (arm, base))
    return ratios(name, paired.values(arm, column), failed, paired.values(base, column), base_failed, rng)


def length_ratio(
    paired: Paired, arm: str, base: str, column: str, rng: np.random.Generator
) -> Interval | None:
    """Summed length over the base's, where both runs of a pair succeeded; None where none did."""
    both = paired.solved(arm) & paired.solved(base)
    mine, other = (
        np.where(both, np.nan_to_num(paired.values(name, column)), 0.0).sum(axis=1) for name in (arm, base)
    )
    some = both.any(axis=1)
    return ratio_of_sums_interval(mine[some], other[some], rng) if some.any() else None


def winning_costs(
    fixed_s: Floats, checks: Floats, others_s: Floats, others_checks: Floats
) -> tuple[Floats, Floats]:
    """Least and largest cost of a check, in s, between which a planner takes less time than K others.

    The time is ``fixed + checks x cost``, with (...) of the planner and (..., K) of the others. The costs are
    (...) each: 0 and infinity where the planner always wins, infinity twice where it never does.
    """
    dearer_s, fewer = fixed_s[..., None] - others_s, others_checks - checks[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        equal_s = dearer_s / fewer
    low_s = np.where(fewer > 0.0, equal_s, 0.0).max(axis=-1, initial=0.0)
    high_s = np.where((fewer < 0.0) & (dearer_s < 0.0), equal_s, np.inf).min(axis=-1, initial=np.inf)
    never = ((fewer <= 0.0) & (dearer_s >= 0.0)).any(axis=-1) | (low_s >= high_s)
    return np.where(never, np.inf, low_s), np.where(never, np.inf, high_s)


def spent(paired: Paired, arm: str, checks: str = "edge_checks") -> Floats:
    """(P, 2) time of an arm without its checks, in s, and number of checks, summed over a problem's runs."""
    request_s, solve_s, check_s, count = (
        paired.values(arm, name) for name in ("request_s", "solve_s", "check_s", checks)
    )
    return np.stack([(request_s + solve_s - check_s).sum(axis=1), count.sum(axis=1)], axis=1)


def break_even(
    name: str, learned: Floats, others: Sequence[Floats], rng: np.random.Generator
) -> Iterator[Measure]:
    """The costs of a check in us from which and until which an arm beats each of some others.

    Arrays are (P, 2) of :func:`spent`, of the same problems. Values are from sums over problems, limits by
    bootstrap over problems; ``typical`` ones from medians.

    Raises:
        EvaluationError: no problems, no others, or others on other problems.
    """
    if not len(learned) or not others or any(len(other) != len(learned) for other in others):
        raise EvaluationError("arms are compared on the same problems, and with one or more others")
    table = np.stack([learned, *others], axis=1)
    # How often a bootstrap sample has each problem: (resamples, P).
    weights = rng.multinomial(len(table), np.full(len(table), 1.0 / len(table)), size=RESAMPLES)
    sums, totals, medians = np.tensordot(weights, table, axes=1), table.sum(axis=0), np.median(table, axis=0)

    def costs_us(of: Floats) -> tuple[Floats, Floats]:
        low_s, high_s = winning_costs(of[..., 0, 0], of[..., 0, 1], of[..., 1:, 0], of[..., 1:, 1])
        return 1e6 * low_s, 1e6 * high_s

    tail = (1.0 - CONFIDENCE) / 2.0
    for what, value, sampled, typical in zip(
        ("from_us", "until_us"), costs_us(totals), costs_us(sums), costs_us(medians), strict=True
    ):
        # One of the values, never between two: halfway to infinity is no number.
        low, high = np.quantile(sampled, [tail, 1.0 - tail], method="inverted_cdf")
        yield f"{name}_{what}", Interval(float(value), float(low), float(high), len(table))
        yield f"{name}_typical_{what}", float(typical)


def summarise_samples(
    runs: pd.DataFrame, families: Iterable[str], arms: Sequence[Arm], setting: Setting
) -> pd.DataFrame:
    """The figures of every arm on every family, for the protocols ``families`` and ``paper``.

    Raises:
        EvaluationError: a family has no problem that all of its arms have run.
    """
    figures: list[tuple[str, str, Measure]] = []
    for family in families:
        paired = Paired(runs[runs["family"] == family])
        # A generator for each family: its intervals do not depend on the others.
        rng = np.random.default_rng([setting.seed, setting.families.names.index(family)])
        present = [arm for arm in arms if arm.name in paired.arms]
        first = [arm for arm in present if arm.stop_at_first]
        for arm in first:
            found = [*_first_solution(paired, arm, first, rng), *_effort(paired, arm, rng)]
            figures += [(family, arm.name, one) for one in found]
        if family in setting.families.solvable:
            optimising, best = [arm for arm in present if not arm.stop_at_first], best_known(paired)
            for arm in optimising:
                figures += [(family, arm.name, one) for one in converge(paired, arm, best, rng)]
    return summary_table(figures)


def _first_solution(
    paired: Paired, arm: Arm, arms: Sequence[Arm], rng: np.random.Generator
) -> Iterator[Measure]:
    """Success, work, and both against uniform samples and against the same samples untreated."""
    solved, iterations = paired.solved(arm.name), paired.values(arm.name, "iterations")
    within = {count: solved & (iterations <= count) for count in WITHIN_COUNTS}
    yield "solved", _share(solved)
    yield from ((f"within_{count}", _share(found)) for count, found in within.items())
    yield "rejected", float((paired.of(arm.name)["reason"] == Reason.REJECTED).sum())
    for column in ("iterations", "edge_checks"):
        yield from _quantiles(column, paired.values(arm.name, column), ~solved)
    if arm.name != arm.base:
        yield from _arm_ratios("iterations_ratio", paired, arm.name, arm.base, "iterations", rng)
        yield from _arm_ratios("edge_checks_ratio", paired, arm.name, arm.base, "edge_checks", rng)
        yield "length_ratio", length_ratio(paired, arm.name, arm.base, "first_length_rad", rng)
    uniform = [one for one in arms if one.group is Group.UNIFORM]
    kind = _SAME.get(arm.planner, arm.planner)
    peers = [one.name for one in uniform if _SAME.get(one.planner, one.planner) == kind]
    own_best = min(peers or [arm.base], key=lambda name: _median_iterations(paired, name))
    if own_best not in (arm.base, arm.name):
        yield from _arm_ratios("iterations_ratio_own_best", paired, arm.name, own_best, "iterations", rng)
    if arm.sampler is not None:
        every = [one.name for one in uniform] or [arm.base]
        for checks, (kind, names) in product(("edge", "state"), (("base", [arm.base]), ("best", every))):
            own, *others = (spent(paired, name, f"{checks}_checks") for name in (arm.name, *names))
            yield from break_even(f"break_even_{checks}_{kind}", own, others, rng)
    if (plain := plain_arm(arm, arms)) is not None:
        beside = paired.solved(plain.name) & (paired.values(plain.name, "iterations") <= WITHIN)
        mine = within[WITHIN]
        yield "treated_lost", float((beside & ~mine).sum())
        yield "treated_won", float((mine & ~beside).sum())
        yield "treated_difference", difference_interval(mine.mean(axis=1), beside.mean(axis=1), rng)


def _effort(paired: Paired, arm: Arm, rng: np.random.Generator) -> Iterator[Measure]:
    """Times, the paper's means, and what a search takes until it ends, with or without success."""
    solved, iterations = paired.solved(arm.name), paired.values(arm.name, "iterations")
    for column in ("solve", "total"):
        values = 1e3 * paired.values(arm.name, f"{column}_s")
        yield from _quantiles(f"{column}_ms", values, ~solved)
        yield f"{column}_ms_mean", mean_interval(values.mean(axis=1), rng)
        yield from _plain_quantiles(f"end_{column}_ms", values)
    for part in PARTS:
        yield from _plain_quantiles(f"{part}_ms", 1e3 * paired.values(arm.name, f"{part}_s"))
    for column in ("iterations", "edge_checks"):
        yield from _plain_quantiles(f"end_{column}", paired.values(arm.name, column))
    lengths = np.where(solved, np.nan_to_num(paired.values(arm.name, "length_rad")), 0.0).sum(axis=1)
    some = solved.any(axis=1)
    if some.any():
        yield "length_rad_mean", ratio_of_sums_interval(lengths[some], solved.sum(axis=1)[some], rng)
    yield "always_solved", _share(solved.all(axis=1))
    ranked = np.where(solved, iterations, iterations.max()).mean(axis=1)
    yield "iterations_mean_median", quantile_interval(ranked, 0.5, rng)


def _plain_quantiles(name: str, values: Floats) -> Iterator[Measure]:
    yield f"{name}_median", float(np.median(values))
    yield f"{name}_p90", float(np.quantile(values, 0.9))


def _share(flags: Any) -> Interval:
    return clopper_pearson(int(flags.sum()), flags.size)


def _median_iterations(paired: Paired, arm: str) -> float:
    return float(np.median(np.where(paired.solved(arm), paired.values(arm, "iterations"), np.inf)))


def best_known(paired: Paired) -> Floats:
    """(P,) length of the shortest accepted path of any arm, rad; infinite where there is none."""
    lengths = np.concatenate([paired.values(arm, "length_rad") for arm in paired.arms], axis=1)
    return np.asarray(np.min(np.where(np.isnan(lengths), np.inf, lengths), axis=1))


def converge(paired: Paired, arm: Arm, best: Floats, rng: np.random.Generator) -> Iterator[Measure]:
    """How soon an optimising arm comes within 5 % of the (P,) best known lengths."""
    reached, missed = until_close(paired, arm.name, best)
    yield "close", _share(~missed)
    for name, scale in (("iterations", 1.0), ("edge_checks", 1.0), ("ms", 1e3)):
        yield from _quantiles(f"close_{name}", reached[name], missed, scale)
    if arm.name != arm.base and arm.base in paired.arms:
        base, base_missed = until_close(paired, arm.base, best)
        values = (reached["iterations"], missed, base["iterations"], base_missed)
        yield from ratios("close_iterations_ratio", *values, rng)
        yield "first_length_ratio", length_ratio(paired, arm.name, arm.base, "first_length_rad", rng)
    lengths = paired.values(arm.name, "length_rad") / best[:, None]
    yield "final_excess", float(np.median(np.where(np.isnan(lengths), np.inf, lengths)))


def until_close(paired: Paired, arm: str, best: Floats) -> tuple[Mapping[str, Floats], Flags]:
    """Effort until a path was within 5 % of the best known, or until the run ended.

    Returns:
        (P, R) iterations, edge checks and time in s under the name ``ms``, and (P, R) whether the path never
        came so close.
    """
    own, shape = paired.of(arm), (paired.problems, paired.repeats)
    limits = CLOSE * np.repeat(best, paired.repeats)
    # The first improvement that is short enough; behind all of them stands the end of the run.
    at = [
        next((step for step, length in enumerate(lengths) if length <= limit), len(lengths))
        for lengths, limit in zip(own["cost_length_rad"], limits, strict=True)
    ]
    found = {}
    for name, cost, last in (
        ("iterations", "cost_iterations", "iterations"),
        ("edge_checks", "cost_edge_checks", "edge_checks"),
        ("ms", "cost_s", "solve_s"),
    ):
        series = ([*costs, end][step] for step, costs, end in zip(at, own[cost], own[last], strict=True))
        found[name] = np.fromiter(series, dtype=np.float64).reshape(shape)
    return found, (at == own["cost_length_rad"].map(len).to_numpy()).reshape(shape)


def summarise_plans(
    runs: pd.DataFrame, pictures: Sequence[int], arms: Sequence[PlanArm], setting: Setting
) -> pd.DataFrame:
    """The figures of the protocol ``plans``.

    Groups are a source of problems, its hard ones, and every family, each with the number of pictures, as in
    ``MotionBenchMaker, 1``.

    Raises:
        EvaluationError: no problem was run by all arms.
    """
    rng, figures = np.random.default_rng(setting.seed), list[tuple[str, str, Measure]]()
    for group, own in plan_groups(runs, pictures, setting).items():
        for checked in (False, True):
            part = own[own["checked"] == checked]
            try:
                paired = Paired(part)
            except EvaluationError:
                continue
            for arm in (one for one in arms if one.name in paired.arms):
                measures = _checks(paired, arm, rng) if checked else _safety(paired, arm, rng)
                figures += [(group, arm.name, one) for one in measures]
    if not figures:
        raise EvaluationError("no problem was run by all arms", expected="one or more", got="none")
    return summary_table(figures)


def plan_groups(runs: pd.DataFrame, pictures: Sequence[int], setting: Setting) -> dict[str, pd.DataFrame]:
    """Runs by group of problems and number of pictures; problems whose ends collide are left out."""
    runs, seen = runs[runs["status"] != NO_PROBLEM], partly_seen(setting.world)
    found = {}
    for count in pictures:
        own = runs[runs["pictures"].isin((0, count))]
        for source in (name for name in seen.sources if (own["source"] == name).any()):
            mine = own[own["source"] == source]
            found[f"{source}, {count}"] = mine
            if (hard := mine[mine["family"].isin(seen.hard)]).size:
                found[f"{source}, {HARD}, {count}"] = hard
        for family in dict.fromkeys(own["family"]):
            found[f"{family}, {count}"] = own[own["family"] == family]
    return found


def _safety(paired: Paired, arm: PlanArm, rng: np.random.Generator) -> Iterator[Measure]:
    """How often paths without exact checks exist and collide."""
    own = paired.of(arm.name)
    paths = own[own["solved"]]
    collides = paths["clearance_m"] <= 0.0
    yield "solved", clopper_pearson(len(paths), len(own))
    yield "refused", clopper_pearson(int((own["status"] == "refused").sum()), len(own))
    if len(paths):
        yield "collide", _share(collides.to_numpy())
        yield "deep", _share((paths["clearance_m"] <= -DEEP_M).to_numpy())
        for low, high in pairwise(UNSEEN_EDGES):
            # The last bin holds its upper end.
            within = paths["unseen"].between(low, high if high < 1.0 else np.inf, inclusive="left")
            if within.any():
                yield f"collide_unseen_{low:.2f}_{high:.2f}", _share(collides[within].to_numpy())
    if (looked := paths["meshes_free"].dropna()).size:
        yield "meshes", _share(~looked.to_numpy(dtype=bool))
    if arm.name != Unseen.FREE and Unseen.FREE.value in paired.arms:
        free = paired.of(Unseen.FREE.value)
        both = (own["solved"].to_numpy() & free["solved"].to_numpy()).astype(bool)
        if both.any():
            mine, theirs = ((one["clearance_m"] <= 0.0).to_numpy()[both] for one in (own, free))
            yield "more", difference_interval(mine, theirs, rng)
    for column in ("search", "score"):
        for what, quantile in (("median", 0.5), ("p95", 0.95)):
            yield f"{column}_ms_{what}", float(1e3 * own[f"{column}_s"].quantile(quantile))
    curve = confidence_curve(own)
    if len(curve):
        half = max(1, len(curve) // 2)
        yield "surer_half_collide", _share(curve["collides"].to_numpy()[:half])
        error = calibration_error(curve["confidence"].to_numpy(), ~curve["collides"].to_numpy())
        yield "calibration_error", error


def confidence_curve(runs: pd.DataFrame) -> pd.DataFrame:
    """What collides if only the paths of the highest confidence are answers, from all runs of one model.

    One row for each path by falling confidence: ``confidence``, ``collides``, the ``answered`` share of the
    problems down to here, and the share of these that collides, ``collide``.
    """
    found = runs[runs["confidence"].notna()].sort_values("confidence", ascending=False, kind="stable")
    curve = pd.DataFrame(
        {"confidence": found["confidence"], "collides": found["clearance_m"] <= 0.0}
    ).reset_index(drop=True)
    curve["answered"] = np.arange(1, len(curve) + 1) / max(1, len(runs))
    curve["collide"] = curve["collides"].expanding().mean()
    return curve


def _checks(paired: Paired, arm: PlanArm, rng: np.random.Generator) -> Iterator[Measure]:
    """Exact checks until the first path; of each problem the median over its runs counts."""
    if CONNECT.name not in paired.arms:
        return
    runs, by_run = paired.runs.copy(), ["family", "problem", "run"]
    # One price of a check for all arms on a problem.
    prices = paired.of(CONNECT.name).set_index(by_run)[["state_check_s", "mesh_check_s"]]
    priced = prices.reindex(pd.MultiIndex.from_frame(runs[by_run]))
    runs["check_s"] = np.minimum(runs["state_checks"] * priced["state_check_s"].to_numpy(), runs["solve_s"])
    own_s = runs["request_s"] + runs["solve_s"] - runs["check_s"]
    for name, price in (("spheres", "state_check_s"), ("meshes", "mesh_check_s")):
        runs[f"{name}_ms"] = 1e3 * (own_s + runs["state_checks"] * priced[price].to_numpy())
    numbers = ["state_checks", "edge_checks", "iterations", "length_rad", "request_s", "solve_s", "solved",
               "spheres_ms", "meshes_ms"]  # fmt: skip
    values = runs[["family", "problem", "arm"]].join(runs[numbers].astype(np.float64))
    typical = values.groupby(["family", "problem", "arm"], as_index=False).median()
    typical["solved"], typical["run"] = typical["solved"] == 1.0, 0
    each = Paired(typical)
    yield "solved", _share(paired.solved(arm.name))
    failed = ~each.solved(arm.name).ravel()
    for column in ("state_checks", "edge_checks", "iterations"):
        yield from _quantiles(column, each.values(arm.name, column), failed)
    for column in ("request", "solve"):
        yield f"{column}_ms_median", 1e3 * float(np.median(paired.values(arm.name, f"{column}_s")))
    for name in ("spheres_ms", "meshes_ms"):
        value = float(np.median(each.values(arm.name, name)))
        yield name, None if math.isnan(value) else value
    if arm.name != CONNECT.name:
        yield "as_is", float(paired.values(arm.name, "as_is").mean())
        yield from _arm_ratios("states_ratio", each, arm.name, CONNECT.name, "state_checks", rng)
        yield "length_ratio", length_ratio(each, arm.name, CONNECT.name, "length_rad", rng)
        whole = Paired(runs)
        mine, base = (spent(whole, name, "state_checks") for name in (arm.name, CONNECT.name))
        yield from break_even("break_even_state_base", mine, [base], rng)


@dataclass(frozen=True, slots=True)
class CensoredSummary:
    """Median and 90th percentile of runs of which some were cut off; a bound is a lower one."""

    median: float
    p90: float
    median_is_bound: bool
    p90_is_bound: bool
    censored: int
    count: int


def summarise_censored(values: ArrayLike, censored: ArrayLike) -> CensoredSummary:
    """Quantiles of (n,) values in which a censored run ranks behind all others; none is dropped."""
    ranked, cut = censored_as_largest(values, censored), np.asarray(censored, dtype=bool)
    finished = np.sort(np.where(cut, np.inf, ranked))
    median, p90 = (float(np.quantile(ranked, q, method="higher")) for q in (0.5, 0.9))
    bounds = [bool(np.isinf(np.quantile(finished, q, method="higher"))) for q in (0.5, 0.9)]
    return CensoredSummary(median, p90, bounds[0], bounds[1], int(cut.sum()), int(cut.size))
