"""The report of the benchmark of plans: tables, the safety figure, and the files that hold them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cspace.errors import StorageError
from cspace.worlds.unseen import Taken
from services.evaluator.benchmark.figures import STYLE
from services.evaluator.benchmark.files import FIGURES, PARQUET, REPORT, STAGE, Saved, metric_name
from services.evaluator.benchmark.plans.setting import PlanRun, PlanSetting
from services.evaluator.benchmark.plans.summary import (
    ALL,
    ArmChecks,
    ArmPlans,
    Checked,
    Plans,
    Sureness,
    gather_checked,
    gather_plans,
    hits,
)
from services.evaluator.benchmark.report import quantiles, table_of
from services.evaluator.benchmark.store import MANIFEST, RunStore, write_parquet
from services.evaluator.benchmark.summary import in_words
from services.evaluator.evaluation.measured import Table, aligned, markdown
from services.evaluator.statistics import Interval
from services.names import EXPERIMENT
from services.registry.tracking.experiment import NOTE, TAG_STAGE
from services.registry.tracking.port import ID, Tracking

SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
NOT_LOOKED_AT = "not looked at"


def plans_table(summaries: Sequence[ArmPlans]) -> Table:
    """Solved and collided, of every arm."""
    return table_of(
        [
            {
                "arm": one.arm,
                "solved": f"{one.solved:.2f}",
                "refused": f"{one.refused.estimate:.2f}",
                "collide": _interval(one.collide),
                "deeper than 1 cm": _interval(one.deep),
                "by meshes": _interval(one.meshes, NOT_LOOKED_AT if one.collide else "-"),
                "more than with unseen free": _interval(one.more),
                "search, ms: p50, p95": "{:.0f}, {:.0f}".format(*one.search_ms),
                "scoring, ms": "{:.0f}, {:.0f}".format(*one.score_ms) if any(one.score_ms) else "-",
            }
            for one in summaries
        ]
    )


def share_table(heading: str, shares: Mapping[str, Mapping[str, Interval | None]]) -> Table:
    """Of the ways of each arm the share that collides, a row a group; how many ways in brackets."""
    return table_of(
        [
            {heading: group}
            | {
                arm: "-" if one is None else f"{one.estimate:.2f} ({one.count})"
                for arm, one in by_arm.items()
            }
            for group, by_arm in shares.items()
        ]
    )


def sureness_table(found: Sequence[Sureness]) -> Table:
    """What collides if only so many of the problems are answered, by the surest ways."""
    rows = []
    for one in found:
        for share in SHARES:
            # Up to rounding of k / n.
            taken = int((one.share <= share + 1e-9).sum())
            if taken:
                rows.append(
                    {
                        "model": one.model,
                        "answered, at most": f"{share:.1f}",
                        "answered": f"{one.share[taken - 1]:.2f}",
                        "min_confidence": f"{one.least[taken - 1]:.3f}",
                        "collide": f"{one.collide[taken - 1]:.3f}",
                    }
                )
    return table_of(rows)


def checks_table(groups: Mapping[str, Sequence[ArmChecks]]) -> Table:
    """Checks until the first path, of every group and arm."""
    return table_of(
        [
            {
                "problems": f"{group} ({one.counts['state_checks'].count})",
                "arm": one.arm,
                "solved": f"{one.solved:.2f}",
                "free as it was": "-" if one.as_is is None else f"{one.as_is:.2f}",
                "states": quantiles(one.counts["state_checks"]),
                "of uniform's median": _interval(None if one.ratios is None else one.ratios[0]),
                "of its p90": _interval(None if one.ratios is None else one.ratios[1]),
                "edges": quantiles(one.counts["edge_checks"]),
                "iterations": quantiles(one.counts["iterations"]),
                "length of uniform's": _interval(one.length),
            }
            for group, summaries in groups.items()
            for one in summaries
        ]
    )


def price_table(groups: Mapping[str, Sequence[ArmChecks]]) -> Table:
    """Times until the first path, by what a look at a state costs."""
    return table_of(
        [
            {
                "problems": group,
                "arm": one.arm,
                "ways, ms": f"{one.request_ms:.1f}",
                "search with checks, ms": f"{one.solve_ms:.1f}",
                "all, spheres, ms": f"{one.spheres_ms:.1f}",
                "all, meshes, ms": NOT_LOOKED_AT if one.meshes_ms is None else f"{one.meshes_ms:.1f}",
                "faster than uniform if a look costs": "-" if one.worth is None else in_words(one.worth),
            }
            for group, summaries in groups.items()
            for one in summaries
        ]
    )


def prices_us(runs: Sequence[object]) -> tuple[float | None, float | None]:
    """Median price of a look at a state, by spheres and by meshes, in us; None where none was measured."""
    found = []
    for column in ("state_check_s", "mesh_check_s"):
        told = [value for run in runs if (value := getattr(run, column)) is not None]
        found.append(1e6 * float(np.median(told)) if told else None)
    return found[0], found[1]


def _interval(one: Interval | None, nothing: str = "-") -> str:
    return nothing if one is None else f"{one:.2f}"


_MARKS = "osD^v<>P"


def safety_figure(found: Sequence[Plans]) -> Figure:
    """A panel for each source and number of pictures: a curve a model, a mark for every other arm."""
    sources = list(dict.fromkeys(one.source for one in found))
    columns = max(sum(one.source == source for one in found) for source in sources)
    with rc_context(STYLE):
        figure = Figure(
            figsize=(4.2 * columns + 0.6, 3.9 * len(sources) + 0.7), dpi=110, layout="constrained"
        )
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(sources), columns, squeeze=False, sharex=True, sharey=True)
        for row, source in zip(grid, sources, strict=True):
            mine = [one for one in found if one.source == source]
            for axes in row[len(mine) :]:
                axes.set_visible(False)
            for axes, one in zip(row, mine, strict=False):
                _panel(axes, one)
            row[0].set_ylabel("share of the ways that collide")
        for axes in grid[-1]:
            axes.set_xlabel("share of the problems that are answered")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _panel(axes: Any, one: Plans) -> None:
    for model in one.models:
        if (sure := one.sureness(model)) is not None:
            axes.plot(sure.share, sure.collide, label=f"{model}, by min_confidence", linewidth=1.8)
    others = [arm for arm in one.arms if arm not in one.models]
    for number, arm in enumerate(others):
        runs = one.arms[arm]
        ways = [run for run in runs if run.solved]
        share = sum(map(hits, ways)) / len(ways) if ways else float("nan")
        mark, colour = _MARKS[number % len(_MARKS)], f"C{len(one.models) + number}"
        at = len(ways) / len(runs)
        axes.plot([at], [share], mark, color=colour, label=arm, markersize=7, clip_on=False, zorder=3)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    pictures = "one picture" if one.pictures == 1 else f"{one.pictures} pictures"
    axes.set_title(f"{one.source}, {pictures}\n{one.count} problem{'s' * (one.count > 1)}", fontsize=10)


READING = (
    "All arms search alike, with the same draws; they differ in what they take the space to be that no "
    "picture shows. Models change their ways until they doubt them less, and choose the least doubtful "
    "instead of the shortest. A way collides where its clearance in truth, by the arm's spheres every "
    "0.01 rad, is not above 0; by meshes where convex hulls of its parts touch. *Solved* and *refused* "
    "are shares of the problems, the others had no more time; what collides is a share of the ways. *More "
    "than with unseen free*: the paired difference of what collides, over problems that both solve. "
    "*Truth where unseen* keeps to what is seen and to the truth, and is what a perfect guess of the "
    "unseen would reach; all that it loses is lost to the pictures' noise. Where unseen space is "
    "occupied, room is made where the arm stands, and about the goal where that is cleared. Square "
    "brackets are 95 % limits, exact (Clopper-Pearson) for shares, by bootstrap over problems for the "
    "rest."
)
SURENESS = (
    "*By min_confidence*: from one run at 0, its ways sorted by confidence; only the surest are taken as "
    "answers, so many of the problems at most, and all others are refused."
)
VIEWS = (
    "1.1 to 1.3 m away, 30 to 60 degrees to the side of the line to the robot, 20 to 40 degrees up, with "
    "noise, the arm in the picture."
)
UNSEEN = "Share of the arm that no picture shows, mean along the way."
CHECKS = (
    "States and edges are checked in truth until the first path, by the project's own RRT-Connect: with "
    "uniform configurations, or with ways that are checked as they are first, the surest first, and "
    "configurations about them where none is free. *Ways of the truth* are searched for in the scene "
    "itself: what a perfect picture would give. Of each problem the median over its runs; of these median"
    " and 90th percentile, where a problem without a path ranks behind all others (> marks what is a "
    "lower bound)."
)
PRICE = (
    "With looks at a state that cost c a piece, a problem takes (reading the picture, ways, the planner's"
    " own work) + states x c. The last column says for which c the ways save time over uniform samples, "
    "in sums over the problems, with 95 % limits by bootstrap; the two before it are medians at the "
    "prices of spheres and meshes."
)
VAMP = (
    "Beside them: vamp's RRT-Connect solves MotionBenchMaker's Panda problems in 35 us at the median by "
    "its authors (Thomason, Kingston and Kavraki 2024), with the whole scene known. Nothing learned wins "
    "there in time."
)


@dataclass(frozen=True)
class PlanResults:
    """All that the runs say.

    Args:
        setting: of all runs.
        runs: that count.
        plans: the first table by source and pictures.
        summaries: of each of these.
        groups: of problems, of the second table.
        checks: of each of these.
    """

    setting: PlanSetting
    runs: tuple[PlanRun, ...]
    plans: tuple[Plans, ...]
    summaries: tuple[tuple[ArmPlans, ...], ...]
    groups: tuple[Checked, ...]
    checks: tuple[tuple[ArmChecks, ...], ...]

    @classmethod
    def gather(cls, runs: Sequence[PlanRun], pictures: Sequence[int], setting: PlanSetting) -> "PlanResults":
        """Pair and summarise the runs."""
        rng, sources = np.random.default_rng(setting.seed), list(setting.seen.sources)
        runs = sorted(runs, key=lambda run: sources.index(run.source))
        plans, groups = gather_plans(runs, pictures), gather_checked(runs, pictures, setting.seen.hard)
        summaries = tuple(tuple(one.summaries(rng)) for one in plans)
        checks = tuple(tuple(one.summaries(rng)) for one in groups)
        return cls(setting, tuple(runs), tuple(plans), summaries, tuple(groups), checks)


def plan_report(results: PlanResults, manifest: Mapping[str, Any], figure: str | None) -> str:
    """The whole report; its first lines are what collides with unseen space free, and of the models' ways.

    Args:
        results: of the benchmark.
        manifest: of its folder.
        figure: path of the figure as seen from the report.
    """
    parts = [headline(results), "# Planning benchmark, protocol `plans`", _about(results, manifest)]
    parts += [f"![safety]({figure})"] if figure else []
    told: set[str] = set()
    for title, note, table in _tables(results):
        # What is said of a kind of table is said once.
        parts += [title, *([note] if note and note not in told else []), markdown(table)]
        told.add(note)
    return "\n\n".join([*parts, VAMP]) + "\n"


def plan_terminal(results: PlanResults) -> str:
    """The same tables, aligned."""
    tables = [f"{title.lstrip('# ')}\n{aligned(table)}" for title, _, table in _tables(results)]
    return "\n\n".join([headline(results), *tables, VAMP]) + "\n"


def headline(results: PlanResults) -> str:
    """What collides in truth, by source and pictures: with unseen space free, and of each model's ways."""
    clauses = []
    for plans, summaries in zip(results.plans, results.summaries, strict=True):
        told = {one.arm: one for one in summaries if one.arm in (*plans.models, Taken.FREE.value)}
        shares = "; ".join(f"{arm} {one.collide:.2f}" for arm, one in told.items() if one.collide is not None)
        clauses.append(f"{_name(plans)}: {shares or 'no ways'}")
    return "Ways without exact checks that collide in truth, of those found. " + ". ".join(clauses) + "."


def _name(one: Plans | Checked) -> str:
    name = one.source if isinstance(one, Plans) else one.name
    return f"{name}, {one.pictures} picture{'s' * (one.pictures > 1)}"


def _about(results: PlanResults, manifest: Mapping[str, Any]) -> str:
    setting, left_out = results.setting, max((one.left_out for one in results.plans), default=0)
    spheres_us, meshes_us = prices_us(results.runs)
    lines = [
        f"- {setting.split} problems, seed {setting.seed}; {setting.ways} ways, {setting.plan_limit_s:g} s.",
        f"- Cameras look at the {setting.aim}; {VIEWS}",
        f"- With exact checks at most {setting.max_iterations} iterations and {setting.checked_limit_s:g} s.",
        f"- Left out for a start or goal that collides by spheres: at most {left_out} of a source.",
    ]
    if spheres_us is not None:
        meshes = "not looked at, for the extra spatial is not installed"
        meshes = meshes if meshes_us is None else f"{meshes_us:.1f} us"
        lines.append(f"- A look at a state, median: spheres {spheres_us:.1f} us, convex meshes {meshes}.")
    used = {run.sampler for run in results.runs}
    for name, one in manifest["samplers"].items():
        if name in used:
            what = one["model"] or "bundle"
            lines.append(f"- {name}: {what}, digest {one['digest'][:12]}, transport {one['transport']}.")
    return "\n".join(lines)


def _tables(results: PlanResults) -> list[tuple[str, str, Table]]:
    """Heading, note and rows of every table that has any."""
    found: list[tuple[str, str, Table]] = []
    for plans, summaries in zip(results.plans, results.summaries, strict=True):
        name = _name(plans)
        found.append(
            (
                f"## Without exact checks: {name}, {plans.count} problem{'s' * (plans.count > 1)}",
                f"{READING}\n\n{SURENESS}",
                plans_table(summaries),
            )
        )
        told = [one for model in plans.models if (one := plans.sureness(model)) is not None]
        halves = "; ".join(
            f"{one.model}: calibration error {one.calibration_error:.3f}, of the surer half "
            f"{one.surer_half:.2f} collide"
            for one in told
        )
        found.append((f"### By min_confidence: {name}", f"{halves}.", sureness_table(told)))
        found.append((f"### Collide, by family: {name}", "", share_table("family", plans.by_family())))
        bins = {f"{low:.2f} to {high:.2f}": one for (low, high), one in plans.by_unseen().items()}
        found.append(
            (f"### Collide, by what is unseen along the way: {name}", UNSEEN, share_table("unseen", bins))
        )
    for pictures in dict.fromkeys(one.pictures for one in results.groups):
        pairs = zip(results.groups, results.checks, strict=True)
        groups = {one.name: rows for one, rows in pairs if one.pictures == pictures}
        name = f"{pictures} picture{'s' * (pictures > 1)}"
        found.append((f"## With exact checks: {name}", CHECKS, checks_table(groups)))
        found.append((f"### Time and price of a check: {name}", PRICE, price_table(groups)))
    return [one for one in found if len(one[2]) > 1]


SAFETY = "safety"


def write_plan_files(results: PlanResults, store: RunStore[PlanRun]) -> None:
    """Writes the table, the figure, and the report that shows it.

    Raises:
        StorageError: a file can not be written.
    """
    out, shown = store.folder, None
    try:
        write_parquet(results.runs, out / PARQUET)
        if results.plans:
            shown = f"{FIGURES}/{SAFETY}.png"
            (out / FIGURES).mkdir(exist_ok=True)
            safety_figure(results.plans).savefig(out / shown)
        (out / REPORT).write_text(plan_report(results, store.manifest(), shown), "utf-8")
    except OSError as error:
        raise StorageError(f"the folder {out} can not be written", got=str(error)) from error


def log_plan_run(tracking: Tracking, results: PlanResults, store: RunStore[PlanRun]) -> str:
    """Settings, metrics and files as a tracking run; its id.

    Raises:
        RegistryError: the server refuses or does not answer.
    """
    setting = results.setting
    name = f"planning, {setting.protocol}, {setting.split}, seed {setting.seed}, {ID}"
    tags = {"protocol": setting.protocol, TAG_STAGE: STAGE}
    with tracking.start(EXPERIMENT, name, tags=tags) as run:
        samplers = {name: one["digest"] for name, one in store.manifest()["samplers"].items()}
        run.params({"setting": asdict(setting), "samplers": samplers})
        run.metrics(plan_metrics(results), 0)
        run.tags({NOTE: headline(results)})
        for part in (MANIFEST, PARQUET, REPORT):
            run.artifact(store.folder / part)
        for path in sorted((store.folder / FIGURES).glob("*.png")):
            run.figure(Saved(path), path.stem)
        run.flush()
        return run.run_id


def plan_metrics(results: PlanResults) -> dict[str, float]:
    """By source, pictures and arm: solved, collide, and states with ways over uniform ones."""
    found: dict[str, float] = {}
    for plans, summaries in zip(results.plans, results.summaries, strict=True):
        for one in summaries:
            place = f"{_group(plans.source, plans.pictures)}/{metric_name(one.arm)}"
            told: dict[str, Interval | None] = {
                "solved": one.solved,
                "collide": one.collide,
                "more": one.more,
            }
            found |= {f"{place}/{name}": part.estimate for name, part in told.items() if part is not None}
        for model in plans.models:
            if (sure := plans.sureness(model)) is not None:
                place = f"{_group(plans.source, plans.pictures)}/{metric_name(model)}"
                found[f"{place}/calibration_error"] = sure.calibration_error
                found[f"{place}/surer_half_collide"] = sure.surer_half.estimate
    for group, checks in zip(results.groups, results.checks, strict=True):
        for one_check in checks if group.name.endswith(f", {ALL}") else ():
            if one_check.ratios is not None:
                name = _group(group.name.removesuffix(f", {ALL}"), group.pictures)
                place = f"{name}/{metric_name(one_check.arm)}"
                found[f"{place}/states_ratio_median"] = one_check.ratios[0].estimate
                found[f"{place}/states_ratio_p90"] = one_check.ratios[1].estimate
    return found


def _group(source: str, pictures: int) -> str:
    return f"{metric_name(source)}_{pictures}"
