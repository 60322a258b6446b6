"""Runs reduced to estimates with 95 % intervals.

Intervals are exact (Clopper-Pearson) for shares and by bootstrap over problems for the rest. Of each problem
the median over its runs counts; one without success ranks behind all others.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.planning.cost import calibration_error
from services.evaluator.benchmark.variants import UNIFORM_CONNECT, Group, Variant
from services.evaluator.statistics import (
    Floats,
    Interval,
    bootstrap_interval,
    clopper_pearson,
    difference_interval,
    point,
    ratio_of_sums_interval,
)

WITHIN = 1000
DEEP_M = 0.01
QUANTILES = {"median": 0.5, "p90": 0.9}
Measures = Iterator[tuple[str, Interval]]
# One of the values, never between two: halfway to infinity is no number.
bootstrap = partial(bootstrap_interval, resamples=2000, method="inverted_cdf")


def share(flags: pd.Series | NDArray[np.bool_]) -> Interval:
    """A share with its exact limits."""
    return clopper_pearson(int(np.sum(flags)), np.size(flags))


class Paired:
    """Runs of a group of problems, with every variant on the same problems equally often.

    Problems that a variant has not run are left out, as are those with fewer runs than others.
    """

    def __init__(self, runs: pd.DataFrame) -> None:
        by = ["family", "problem", "run"]
        counts = runs.groupby(by)["variant"].nunique()
        complete = counts[counts == runs["variant"].nunique()]
        each = complete.groupby(level=by[:2]).transform("size")
        kept = complete[each == each.max()].index
        if kept.empty:
            raise EvaluationError("no problem was run by all variants", expected="one or more", got="none")
        self.repeats = int(each.max())
        self.problems = len(kept) // self.repeats
        rows = runs.set_index(by).loc[kept].reset_index()
        self._by_variant = {str(name): own for name, own in rows.groupby("variant")}

    def __contains__(self, variant: object) -> bool:
        return variant in self._by_variant

    def of(self, variant: str) -> pd.DataFrame:
        """The runs of a variant, problem by problem."""
        return self._by_variant[variant]

    def values(self, variant: str, column: str) -> Floats:
        """(P, R) values of a column; nan where a run has none."""
        found: Floats = self.of(variant)[column].to_numpy(dtype=np.float64, na_value=np.nan)
        return found.reshape(self.problems, self.repeats)

    def solved(self, variant: str) -> NDArray[np.bool_]:
        """(P, R) whether a run succeeded."""
        return self.values(variant, "solved").astype(bool)

    def typical(self, variant: str, column: str) -> Floats:
        """(P,) median over each problem's runs, infinite where most of them fail."""
        values = np.where(self.solved(variant), self.values(variant, column), np.inf)
        return np.asarray(np.quantile(values, 0.5, axis=1, method="higher"))


def quantiles(name: str, values: Floats) -> Measures:
    """Median and 90th percentile of (P,) values, infinite where they fall among the failures."""
    for what, quantile in QUANTILES.items():
        yield f"{name}_{what}", point(float(np.quantile(values, quantile, method="higher")), len(values))


def ratios(name: str, values: Floats, base: Floats, rng: np.random.Generator) -> Measures:
    """Quantiles of (P,) values over those of a base; a failure counts as the largest value of both."""
    both = np.concatenate([values, base])
    largest = both[np.isfinite(both)].max(initial=1.0)
    # A direct connection takes no iteration to speak of; one unit keeps the ratio finite.
    table = np.clip(np.stack([values, base], axis=1), 1.0, largest)
    for what, quantile in QUANTILES.items():

        def ratio(rows: Floats, quantile: float = quantile) -> Floats:
            mine, other = np.moveaxis(np.quantile(rows, quantile, axis=-2), -1, 0)
            return np.asarray(mine / other)

        yield f"{name}_{what}", bootstrap(table, ratio, rng)


def break_even_us(spent: Floats) -> Floats:
    """The cost of a check, in us, from which on the first of some variants takes less time than each other.

    ``spent`` (..., K, 2) is time without checks, in s, and number of checks of each variant. Returns (...), 0
    where it always takes less time, infinity where it never does for all costs above some cost.
    """
    dearer_s = spent[..., :1, 0] - spent[..., 1:, 0]
    fewer = spent[..., 1:, 1] - spent[..., :1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        equal_s = np.maximum(dearer_s / fewer, 0.0)
    same = np.where((fewer == 0.0) & (dearer_s < 0.0), 0.0, np.inf)
    return np.asarray(1e6 * np.where(fewer > 0.0, equal_s, same).max(axis=-1))


def _spent(paired: Paired, variant: str, checks: str) -> Floats:
    """(P, 2) time without checks, in s, and number of checks, summed over each problem's runs."""
    request_s, solve_s, price_s, states, count = (
        np.nan_to_num(paired.values(variant, column))
        for column in ("request_s", "solve_s", "state_check_s", "state_checks", f"{checks}_checks")
    )
    fixed_s = request_s + solve_s - np.minimum(states * price_s, solve_s)
    return np.stack([fixed_s.sum(axis=1), count.sum(axis=1)], axis=1)


def exact(paired: Paired, variant: Variant) -> Measures:
    """Success, work and time with exact checks."""
    name = variant.name
    solved = paired.solved(name)
    yield "solved", share(solved)
    yield f"within_{WITHIN}", share(solved & (paired.values(name, "iterations") <= WITHIN))
    for column in ("iterations", "edge_checks", "state_checks"):
        yield from quantiles(column, paired.typical(name, column))
    for column in ("request", "solve", "total"):
        values_ms = 1e3 * paired.values(name, f"{column}_s")
        yield from quantiles(f"{column}_ms", values_ms)
        yield f"{column}_ms_mean", point(float(values_ms.mean()), len(values_ms))
    if solved.any():
        yield (
            "length_rad_mean",
            point(float(paired.values(name, "length_rad")[solved].mean()), paired.problems),
        )
    if variant.group is Group.PATHS and variant.name != UNIFORM_CONNECT:
        yield "as_is", point(float(paired.values(name, "as_is").mean()), paired.problems)


def against(paired: Paired, variant: Variant, uniform: Sequence[str], rng: np.random.Generator) -> Measures:
    """Work against the base, and the costs of a check from which on the variant saves time.

    These costs are over the base and over the best of the uniform variants.
    """
    name, base = variant.name, UNIFORM_CONNECT if variant.group is Group.PATHS else variant.base
    if base is None or base == name or base not in paired:
        return
    columns = {"iterations": "iterations", "edge_checks": "edge_checks", "states": "state_checks"}
    for what, column in columns.items():
        yield from ratios(f"{what}_ratio", paired.typical(name, column), paired.typical(base, column), rng)
    lengths = np.stack([paired.typical(one, "length_rad") for one in (name, base)])
    lengths = lengths[:, np.isfinite(lengths).all(axis=0)]
    if lengths.size:
        yield "length_ratio", ratio_of_sums_interval(lengths[0], lengths[1], rng)
    for checks, (what, others) in product(("edge", "state"), (("base", [base]), ("best", uniform))):
        if others:
            spent = np.stack([_spent(paired, one, checks) for one in (name, *others)], axis=1)
            found = bootstrap(spent, lambda rows: break_even_us(rows.sum(axis=-3)), rng)
            yield f"break_even_{checks}_{what}_from_us", found


def safety(paired: Paired, variant: Variant, rng: np.random.Generator) -> Measures:
    """How often paths without exact checks exist and collide."""
    own = paired.of(variant.name)
    paths = own[own["solved"]]
    yield "solved", share(own["solved"])
    yield "refused", share(own["status"] == "refused")
    if len(paths):
        yield "collide", share(paths["clearance_m"] <= 0.0)
        yield "deep", share(paths["clearance_m"] <= -DEEP_M)
    if (looked := paths["meshes_free"].dropna()).size:
        yield "meshes", share(~looked.to_numpy(dtype=bool))
    if variant.base is not None and variant.name != variant.base and variant.base in paired:
        base = paired.of(variant.base)
        both = own["solved"].to_numpy() & base["solved"].to_numpy()
        if both.any():
            mine, others = ((one["clearance_m"] <= 0.0).to_numpy()[both].astype(float) for one in (own, base))
            yield "more", difference_interval(mine, others, rng)
    for column in ("search", "score", "request"):
        yield from quantiles(f"{column}_ms", 1e3 * paired.values(variant.name, f"{column}_s"))
    curve = confidence_curve(own)
    if len(curve):
        yield "surer_half_collide", share(curve["collides"][: max(1, len(curve) // 2)])
        error = calibration_error(curve["confidence"].to_numpy(), ~curve["collides"].to_numpy())
        yield "calibration_error", point(error, len(curve))


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
