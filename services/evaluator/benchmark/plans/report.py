"""The benchmark of plans for readers: the safety of plans first, then both tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cspace.worlds.unseen import Taken
from services.evaluator.benchmark.plans.checked import ArmChecks, Checked
from services.evaluator.benchmark.plans.checked import gather_checked
from services.evaluator.benchmark.plans.record import PlanRun
from services.evaluator.benchmark.plans.rows import (
    checks_table,
    plans_table,
    price_table,
    prices_us,
    share_table,
    sureness_table,
)
from services.evaluator.benchmark.plans.setting import PlanSetting
from services.evaluator.benchmark.plans.unchecked import ArmPlans, Plans
from services.evaluator.benchmark.plans.unchecked import gather_plans
from services.evaluator.evaluation.tables import Table, aligned, markdown

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
