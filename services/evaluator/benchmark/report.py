"""The benchmark's results: one long table of estimates, and the report made of it."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from cspace.errors import EvaluationError
from cspace.simulator import UnseenPolicy
from cspace.worlds import partly_seen
from services.evaluator.benchmark.estimates import WITHIN, Paired, against, confidence_curve, exact, safety
from services.evaluator.benchmark.variants import NO_PROBLEM, Group, Protocol, Setting, Variant
from services.evaluator.statistics import Interval
from services.planner.plotting import INK

HARD = "the hard ones"
# The measures that become metrics of the tracking run; its table of variants holds all of them.
METRICS = (
    "solved", "iterations_median", "edge_checks_median", "iterations_ratio_median", "collide", "more",
    "calibration_error", "surer_half_collide", "states_ratio_median", "states_ratio_p90",
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
        "solved", "request_ms_median", "solve_ms_median", "solve_ms_mean", "total_ms_median", "total_ms_p90",
        "length_rad_mean",
    )),
    "Plans without exact checks": ((Group.PLANS,), (
        "solved", "refused", "collide", "deep", "meshes", "more", "calibration_error", "request_ms_median",
        "request_ms_p90",
    )),
    "Paths with exact checks": ((Group.PATHS,), (
        "solved", "as_is", "state_checks_median", "states_ratio_median", "states_ratio_p90",
        "request_ms_median", "solve_ms_median", "break_even_state_base_from_us",
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
    def summary(self) -> pd.DataFrame:
        """The estimates as one long table."""
        rows = [
            (group, variant, measure, interval, interval.estimate, interval.low, interval.high)
            for number, (group, runs) in enumerate(self.groups.items())
            for variant, measure, interval in self._estimates(group, runs, [self.setting.seed, number])
        ]
        if not rows:
            raise EvaluationError("no problem was run by all variants", expected="one or more", got="none")
        columns = ["family", "variant", "measure", "interval", "value", "low", "high"]
        return pd.DataFrame(rows, columns=columns)

    def _estimates(
        self, group: str, runs: pd.DataFrame, seed: list[int]
    ) -> Iterator[tuple[str, str, Interval]]:
        """Variant, measure and estimate of a group of problems."""
        rng = np.random.default_rng(seed)
        for kinds in (_FIRST, (Group.PLANS,), (Group.PATHS,)):
            own = runs[runs["group"].isin(kinds)]
            if own.empty:
                continue
            paired = Paired(own)
            present = [one for one in self.variants if one.name in paired]
            uniform = [one.name for one in present if one.group is Group.UNIFORM]
            for one in present:
                if one.group is Group.PLANS:
                    measures = list(safety(paired, one, rng))
                else:
                    measures = list(exact(paired, one))
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
        for name, one in self.manifest["samplers"].items():
            if name in used:
                what = one["model"] or "bundle"
                facts.append(f"- {name}: {what}, digest {one['digest'][:12]}, transport {one['transport']}.")
        title = f"# Planning benchmark, protocol `{setting.protocol}`"
        shown = [f"![{path}]({path})" for path in figures]
        parts = [title, "\n".join(facts), READING, *_sections(self.tables), *shown]
        return "\n\n".join(parts) + "\n"


def _sections(tables: Mapping[str, pd.DataFrame]) -> Iterator[str]:
    for heading, table in tables.items():
        yield f"## {heading}\n\n{table.to_markdown(index=False, disable_numparse=True)}"


# Told apart by most eyes, and in print by their lightness (after Okabe and Ito).
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_STYLE: dict[Any, Any] = {"font.size": 9, "axes.grid": True, "grid.color": "#e6e8ec", "axes.axisbelow": True}
_BESIDE: dict[str, Any] = {
    "loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "frameon": False, "fontsize": 8,
}  # fmt: skip
_LINES = ("-", "--", ":", "-.")


def figures(results: Results) -> Iterator[tuple[str, Figure]]:
    """Every figure that the runs have content for, with its name."""
    with rc_context(_STYLE):
        for name, plot, groups in (
            ("success", _success, {Group.UNIFORM, Group.LEARNED}),
            ("safety", _safety, {Group.PLANS}),
        ):
            found = {}
            for group, runs in results.groups.items():
                own = runs[runs["group"].isin(groups)]
                if len(own) and own["solved"].any():
                    found[group] = Paired(own)
            if found:
                yield name, plot(found, results)


def _panels(rows: int, columns: int, width: float = 4.2) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width * columns + 2.0, 3.4 * rows), dpi=110, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def _looks(paired: Paired, results: Results) -> dict[str, dict[str, Any]]:
    """Colour and line of each variant of a panel; uniform ones are black."""
    shown = [one for one in results.variants if one.name in paired]
    uniform, learned = cycle(_LINES), cycle([(c, line) for line in _LINES for c in _COLOURS])
    looks = {}
    for one in shown:
        colour, line = (INK, next(uniform)) if one.sampler is None else next(learned)
        looks[one.name] = {"color": colour, "linestyle": line, "label": one.name}
    return looks


def _success(found: dict[str, Paired], results: Results) -> Figure:
    """Share solved against iterations, edge checks and whole time, a row for each family."""
    shown = (("iterations", 1.0, "iterations"), ("edge_checks", 1.0, "edge checks"), ("total_s", 1e3, "ms"))
    figure, grid = _panels(len(found), 3)
    for row, (family, paired) in zip(grid, found.items(), strict=True):
        for axes, (column, scale, label) in zip(row, shown, strict=True):
            for name, look in _looks(paired, results).items():
                solved = paired.solved(name)
                taken = np.sort(scale * paired.values(name, column)[solved])
                shares = np.arange(1, len(taken) + 1) / solved.size
                axes.step(np.maximum(taken, 1e-3), shares, where="post", **look)
            axes.set(xscale="log", xlabel=label, ylim=(-0.02, 1.02))
        row[0].set_ylabel(f"{family}\nshare solved")
        row[-1].legend(**_BESIDE)
    return figure


def _safety(found: dict[str, Paired], results: Results) -> Figure:
    """Share of colliding paths against answered problems: a curve for each model, a mark for each rule."""
    sources = {
        name: one for name, one in found.items() if name.partition(",")[0] in set(results.runs["source"])
    }
    figure, grid = _panels(1, len(sources))
    for axes, (group, paired) in zip(grid[0], sources.items(), strict=True):
        for one in (one for one in results.variants if one.name in paired):
            own = paired.of(one.name)
            if one.sampler is not None:
                curve = confidence_curve(own)
                axes.plot(curve["answered"], curve["collide"], label=one.name)
            elif one.unseen is not UnseenPolicy.KNOWN and own["solved"].any():
                collide = (own["clearance_m"][own["solved"]] <= 0.0).mean()
                axes.plot(own["solved"].mean(), collide, "o", label=one.name)
        axes.set(
            title=f"{group} picture(s)\n{paired.problems} problems", xlabel="share of the problems answered"
        )
        axes.set(xlim=(0.0, 1.02), ylim=(0.0, None))
    grid[0][0].set_ylabel("share of the paths that collide")
    grid[0][-1].legend(**_BESIDE)
    return figure
