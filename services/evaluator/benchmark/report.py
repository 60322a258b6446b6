"""The benchmark's results: estimates with 95 % intervals in one long table, and the report made of it.

Intervals are exact (Clopper-Pearson) for shares and by bootstrap over problems for the rest. Of each problem
the median over its runs counts; one without success ranks behind all others.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.planning.cost import calibration_error
from cspace.simulator import UnseenPolicy
from cspace.worlds import partly_seen
from services.evaluator.benchmark.variants import NO_PROBLEM, Group, Protocol, Setting, Variant
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
QUANTILES = {"median": 0.5, "p90": 0.9}
HARD = "the hard ones"
Measures = Iterator[tuple[str, Interval]]
# One of the values, never between two: halfway to infinity is no number.
bootstrap = partial(bootstrap_interval, resamples=2000, method="inverted_cdf")
# The measures that become metrics of the tracking run; its table of variants holds all of them.
METRICS = (
    "solved", "iterations_median", "edge_checks_median", "iterations_ratio_median", "collide", "more",
    "calibration_error",
)  # fmt: skip
_FIRST = (Group.UNIFORM, Group.LEARNED)
# Variants and measures of each table.
TABLES: Mapping[str, tuple[tuple[Group, ...], tuple[str, ...]]] = {
    "Work": (_FIRST, (
        f"within_{WITHIN}", "iterations_median", "iterations_p90", "iterations_ratio_median",
        "iterations_ratio_p90", "edge_checks_median", "edge_checks_ratio_median", "length_ratio",
    )),
    "Break-even costs of a check": ((Group.LEARNED,), (
        "break_even_edge_base_from_us", "break_even_edge_best_from_us", "break_even_state_base_from_us",
        "break_even_state_best_from_us",
    )),
    "Time": (_FIRST, (
        "solved", "request_ms_median", "solve_ms_median", "total_ms_median", "total_ms_p90",
    )),
    "Plans without exact checks": ((Group.PLANS,), (
        "solved", "refused", "collide", "meshes", "more", "calibration_error", "request_ms_median",
        "request_ms_p90",
    )),
}  # fmt: skip
READING = (
    "Square brackets are 95 % limits: exact for shares, by bootstrap over problems for the rest. Of each "
    "problem the median over its runs counts; one without success ranks behind all others, and *inf* means "
    "that it does not succeed that often. Ratios are to the same planner with uniform samples. If a check "
    "costs c, a problem takes (requests + the planner's own work) + checks x c: *break even* is the c from "
    "which on a variant takes less time than the *base*, or than the *best* uniform variant; 0 is always, "
    "inf never. A path collides where its true clearance, by spheres every 0.01 rad, is not above 0. *More* "
    "is the paired difference to the variant that takes unseen space as free."
)


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
        self.by_variant = {str(name): own for name, own in rows.groupby("variant")}

    def values(self, variant: str, column: str) -> Floats:
        """(P, R) values of a column; nan where a run has none."""
        found: Floats = self.by_variant[variant][column].to_numpy(dtype=np.float64, na_value=np.nan)
        return found.reshape(self.problems, self.repeats)

    def solved(self, variant: str) -> NDArray[np.bool_]:
        """(P, R) whether a run succeeded."""
        return self.values(variant, "solved").astype(bool)

    def typical(self, variant: str, column: str) -> Floats:
        """(P,) median over each problem's runs, infinite where most of them fail."""
        values = np.where(self.solved(variant), self.values(variant, column), np.inf)
        return np.asarray(np.quantile(values, 0.5, axis=1, method="higher"))


def share(flags: pd.Series | NDArray[np.bool_]) -> Interval:
    """A share with its exact limits."""
    return clopper_pearson(int(np.sum(flags)), np.size(flags))


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


def exact(paired: Paired, name: str) -> Measures:
    """Success, work and time with exact checks."""
    solved = paired.solved(name)
    yield "solved", share(solved)
    yield f"within_{WITHIN}", share(solved & (paired.values(name, "iterations") <= WITHIN))
    for column in ("iterations", "edge_checks"):
        yield from quantiles(column, paired.typical(name, column))
    for column in ("request", "solve", "total"):
        yield from quantiles(f"{column}_ms", 1e3 * paired.values(name, f"{column}_s"))


def against(paired: Paired, variant: Variant, uniform: Sequence[str], rng: np.random.Generator) -> Measures:
    """Work against the base, and the costs of a check from which on the variant saves time.

    These costs are over the base and over the best of the uniform variants.
    """
    name, base = variant.name, variant.base
    if base is None or base == name or base not in paired.by_variant:
        return
    for column in ("iterations", "edge_checks"):
        yield from ratios(f"{column}_ratio", paired.typical(name, column), paired.typical(base, column), rng)
    lengths = np.stack([paired.typical(one, "length_rad") for one in (name, base)])
    lengths = lengths[:, np.isfinite(lengths).all(axis=0)]
    if lengths.size:
        yield "length_ratio", ratio_of_sums_interval(lengths[0], lengths[1], rng)
    for checks, (what, others) in product(("edge", "state"), (("base", [base]), ("best", uniform))):
        spent = np.stack([_spent(paired, one, checks) for one in (name, *others)], axis=1)
        found = bootstrap(spent, lambda rows: break_even_us(rows.sum(axis=-3)), rng)
        yield f"break_even_{checks}_{what}_from_us", found


def safety(paired: Paired, variant: Variant, rng: np.random.Generator) -> Measures:
    """How often paths without exact checks exist and collide."""
    own = paired.by_variant[variant.name]
    paths = own[own["solved"]]
    yield "solved", share(own["solved"])
    yield "refused", share(own["status"] == "refused")
    if len(paths):
        yield "collide", share(paths["clearance_m"] <= 0.0)
    if (looked := paths["meshes_free"].dropna()).size:
        yield "meshes", share(~looked.to_numpy(dtype=bool))
    base = paired.by_variant.get(variant.base or "")
    if base is not None and variant.name != variant.base:
        both = own["solved"].to_numpy() & base["solved"].to_numpy()
        if both.any():
            mine, others = ((one["clearance_m"] <= 0.0).to_numpy()[both].astype(float) for one in (own, base))
            yield "more", difference_interval(mine, others, rng)
    yield from quantiles("request_ms", 1e3 * paired.values(variant.name, "request_s"))
    sure = own[own["confidence"].notna()]
    if len(sure):
        error = calibration_error(sure["confidence"].to_numpy(), (sure["clearance_m"] > 0.0).to_numpy())
        yield "calibration_error", point(error, len(sure))


def confidence_curve(runs: pd.DataFrame) -> pd.DataFrame:
    """What collides if only the paths of the highest confidence are answers, from all runs of one model.

    One row for each path by falling confidence: the ``answered`` share of the problems down to here, and the
    share of these that collides, ``collide``.
    """
    found = runs[runs["confidence"].notna()].sort_values("confidence", ascending=False, kind="stable")
    answered = np.arange(1, len(found) + 1) / max(1, len(runs))
    return pd.DataFrame({"answered": answered, "collide": (found["clearance_m"] <= 0.0).expanding().mean()})


def metric_name(name: str) -> str:
    """A name as a part of a metric's."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name.replace("*", "star")).strip("_")


@dataclass(frozen=True)
class Results:
    """A finished benchmark: its runs, one row each, and what is made of them."""

    runs: pd.DataFrame
    setting: Setting
    variants: tuple[Variant, ...]
    pictures: tuple[int, ...]
    manifest: Mapping[str, Any]

    @cached_property
    def groups(self) -> dict[str, pd.DataFrame]:
        """Runs by family; of plans by source, its hard families, and family, each by number of pictures."""
        if self.setting.protocol is not Protocol.PLANS:
            return {str(name): own for name, own in self.runs.groupby("family", sort=False)}
        runs, hard = self.runs[self.runs["status"] != NO_PROBLEM], partly_seen(self.setting.world).hard
        found = {}
        for count in self.pictures:
            own = runs[runs["pictures"].isin((0, count))]
            for source, mine in own.groupby("source", sort=False):
                found[f"{source}, {count}"] = mine
                if len(hardest := mine[mine["family"].isin(hard)]):
                    found[f"{source}, {HARD}, {count}"] = hardest
            found |= {f"{family}, {count}": mine for family, mine in own.groupby("family", sort=False)}
        return found

    @cached_property
    def paired(self) -> dict[str, Paired]:
        """The runs of each group of problems, paired."""
        return {group: Paired(runs) for group, runs in self.groups.items()}

    @cached_property
    def summary(self) -> pd.DataFrame:
        """The estimates as one long table."""
        rows = [
            (group, variant, measure, interval, interval.estimate, interval.low, interval.high)
            for number, (group, paired) in enumerate(self.paired.items())
            for variant, measure, interval in self._estimates(group, paired, [self.setting.seed, number])
        ]
        if not rows:
            raise EvaluationError("no problem was run by all variants", expected="one or more", got="none")
        columns = ["family", "variant", "measure", "interval", "value", "low", "high"]
        return pd.DataFrame(rows, columns=columns)

    def present(self, paired: Paired) -> list[Variant]:
        """The variants of a group of problems."""
        return [one for one in self.variants if one.name in paired.by_variant]

    def _estimates(self, group: str, paired: Paired, seed: list[int]) -> Iterator[tuple[str, str, Interval]]:
        """Variant, measure and estimate of a group of problems."""
        rng, present = np.random.default_rng(seed), self.present(paired)
        uniform = [one.name for one in present if one.group is Group.UNIFORM]
        for one in present:
            if one.group is Group.PLANS:
                measures = list(safety(paired, one, rng))
            else:
                measures = list(exact(paired, one.name))
                if group not in self.setting.families.unsolvable:
                    measures += against(paired, one, uniform, rng)
            yield from ((one.name, *measure) for measure in measures)

    def metrics(self) -> dict[str, float]:
        """Finite values for the tracking run, as in ``narrow/RRT_path_70/iterations_ratio_median``."""
        found = self.summary[self.summary["measure"].isin(METRICS) & np.isfinite(self.summary["value"])]
        names = found["family"].map(metric_name) + "/" + found["variant"].map(metric_name)
        return dict(zip(names + "/" + found["measure"], found["value"], strict=True))

    def columns(self) -> dict[str, list[Any]]:
        """The summary for the tracking run: finite numbers, metric names."""
        found = self.summary.drop(columns="interval")
        found = found[np.isfinite(found["value"])].replace([np.inf, -np.inf], np.nan)
        found["variant"] = found["variant"].map(metric_name)
        return {
            str(name): one.tolist() for name, one in found.astype(object).where(found.notna(), None).items()
        }

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The report's tables by heading."""
        found, kinds = {}, {one.name: one.group for one in self.variants}
        for group, own in self.summary.groupby("family", sort=False):
            for heading, (groups, measures) in TABLES.items():
                mine = own[own["variant"].map(kinds).isin(groups) & own["measure"].isin(measures)]
                if len(mine):
                    texts = mine.assign(text=[f"{one:.4g}" for one in mine["interval"]])
                    table = texts.pivot(index="variant", columns="measure", values="text")
                    rows, columns = mine["variant"].unique(), [name for name in measures if name in table]
                    found[f"{heading}: {group}"] = table.loc[rows, columns].fillna("").reset_index()
        return found

    def note(self) -> str:
        """The main tables, for a terminal and the run's page."""
        main = ("Break-even", "Work", "Plans without")
        shown = {name: one for name, one in self.tables.items() if name.startswith(main)}
        return "\n\n".join(_sections(shown)) + "\n"

    def markdown(self, figures: Sequence[str]) -> str:
        """The whole report; figures are paths relative to it."""
        setting, used = self.setting, set(self.runs["sampler"].dropna())
        out = self.runs[self.runs["status"] == NO_PROBLEM][["family", "problem"]].drop_duplicates()
        limit = f"{setting.max_iterations} iterations or {setting.time_limit_s:g} s"
        facts = [
            f"- {setting.split} problems, seed {setting.seed}. A search ends after {limit}.",
            f"- A state check takes {1e6 * self.runs['state_check_s'].median():.2f} us (median).",
            f"- {len(out)} problems are left out, because their start or goal collides.",
        ]
        for name, digest in self.manifest["samplers"].items():
            if name in used:
                facts.append(f"- {name}: digest {digest[:12]}.")
        title = f"# Planning benchmark, protocol `{setting.protocol}`"
        shown = [f"![{path}]({path})" for path in figures]
        parts = [title, "\n".join(facts), READING, *_sections(self.tables), *shown]
        return "\n\n".join(parts) + "\n"


def _sections(tables: Mapping[str, pd.DataFrame]) -> Iterator[str]:
    for heading, table in tables.items():
        yield f"## {heading}\n\n{table.to_markdown(index=False, disable_numparse=True)}"


def figures(results: Results) -> dict[str, Figure]:
    """The figure of the results, with its name."""
    if results.setting.protocol is Protocol.PLANS:
        return {"safety": _safety(results)}
    return {"success": _success(results)}


def _panels(rows: int, columns: int) -> tuple[Figure, Any]:
    figure = Figure(figsize=(4.2 * columns + 2.0, 3.4 * rows), dpi=110, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def _legend(axes: Any) -> None:
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8)


def _success(results: Results) -> Figure:
    """Share solved against iterations, edge checks and whole time, a row for each family."""
    shown = (("iterations", 1.0, "iterations"), ("edge_checks", 1.0, "edge checks"), ("total_s", 1e3, "ms"))
    figure, grid = _panels(len(results.paired), 3)
    for row, (family, paired) in zip(grid, results.paired.items(), strict=True):
        for axes, (column, scale, label) in zip(row, shown, strict=True):
            for one in results.present(paired):
                solved = paired.solved(one.name)
                taken = np.sort(scale * paired.values(one.name, column)[solved])
                shares = np.arange(1, len(taken) + 1) / solved.size
                # Uniform samples are dashed.
                line = "--" if one.sampler is None else "-"
                axes.step(np.maximum(taken, 1e-3), shares, line, where="post", label=one.name)
            axes.set(xscale="log", xlabel=label, ylim=(-0.02, 1.02))
        row[0].set_ylabel(f"{family}\nshare solved")
        _legend(row[-1])
    return figure


def _safety(results: Results) -> Figure:
    """Share of colliding paths against answered problems: a curve for each model, a mark for each rule."""
    sources = set(results.runs["source"])
    found = {name: one for name, one in results.paired.items() if name.partition(",")[0] in sources}
    figure, grid = _panels(1, len(found))
    for axes, (group, paired) in zip(grid[0], found.items(), strict=True):
        for one in results.present(paired):
            own = paired.by_variant[one.name]
            if one.sampler is not None:
                curve = confidence_curve(own)
                axes.plot(curve["answered"], curve["collide"], label=one.name)
            elif one.unseen is not UnseenPolicy.KNOWN and own["solved"].any():
                collide = (own["clearance_m"][own["solved"]] <= 0.0).mean()
                axes.plot(own["solved"].mean(), collide, "o", label=one.name)
        title = f"{group} picture(s)\n{paired.problems} problems"
        axes.set(title=title, xlabel="share of the problems answered", xlim=(0.0, 1.02), ylim=(0.0, None))
    grid[0][0].set_ylabel("share of the paths that collide")
    _legend(grid[0][-1])
    return figure
