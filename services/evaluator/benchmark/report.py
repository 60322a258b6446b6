"""The benchmark's report: a headline, then tables that are made from the summary."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cspace.simulator import Taken as Unseen
from cspace.worlds import partly_seen
from services.evaluator.benchmark.arms import (
    DEFAULT_SHARE,
    Arm,
    Group,
    PlanArm,
    Protocol,
    Setting,
    plain_arm,
)
from services.evaluator.benchmark.plans import NO_PROBLEM
from services.evaluator.benchmark.summary import (
    UNSEEN_EDGES,
    WITHIN,
    WITHIN_COUNTS,
    Paired,
    confidence_curve,
    plan_groups,
)
from services.evaluator.statistics import Interval
from services.evaluator.tables import aligned, markdown

SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
Figures = Mapping[str, Interval]
Cell = Callable[[Figures], str]
# Heading, note and rows.
Section = tuple[str, str, pd.DataFrame]


def figures_of(summary: pd.DataFrame) -> dict[tuple[str, str], dict[str, Interval]]:
    """The summary by group and arm: estimates by measure."""
    found: dict[tuple[str, str], dict[str, Interval]] = {}
    for row in summary.itertuples(index=False):
        one = Interval(row.value, row.low, row.high, row.count)
        found.setdefault((row.family, row.arm), {})[row.measure] = one
    return found


def interval(name: str, form: str = ".2f", missing: str = "-") -> Cell:
    """``0.86 [0.84, 0.87]``."""
    return lambda found: f"{found[name]:{form}}" if name in found else missing


def number(name: str, form: str = ".0f", missing: str = "-") -> Cell:
    """A value without its limits."""
    return lambda found: f"{found[name].estimate:{form}}" if name in found else missing


def quantiles(name: str, form: str = ".0f", high: str = "p90") -> Cell:
    """Median and 90th percentile, each with > where it is only a lower bound."""

    def text(one: Interval) -> str:
        return f"{'>' if math.isinf(one.high) else ''}{one.estimate:{form}}"

    return lambda found: f"{text(found[f'{name}_median'])} ({text(found[f'{name}_{high}'])})"


def worth(name: str) -> Cell:
    """``above 21 us [17, 26]``, ``always``, ``never``, or what else there is."""

    def cell(found: Figures) -> str:
        if f"{name}_from_us" not in found:
            return "-"
        start, until = found[f"{name}_from_us"], found[f"{name}_until_us"]
        words = costs_in_words(start.estimate, until.estimate)
        if (words == "always" and start.high == 0.0) or (words == "never" and math.isinf(start.low)):
            return words
        edge = until if start.estimate == 0.0 and not math.isinf(until.estimate) else start
        return f"{words} [{_us(edge.low)}, {_us(edge.high)}]"

    return cell


def costs_in_words(from_us: float, until_us: float) -> str:
    """Between which costs of a check, in us, something is worth it."""
    if from_us >= until_us:
        return "never"
    if math.isinf(until_us):
        return "always" if from_us == 0.0 else f"above {_us(from_us)} us"
    if from_us == 0.0:
        return f"below {_us(until_us)} us"
    return f"between {_us(from_us)} and {_us(until_us)} us"


def _us(value: float) -> str:
    if math.isinf(value):
        return "never"
    return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


def _typical(found: Figures) -> str:
    names = (f"break_even_edge_base_typical_{name}" for name in ("from_us", "until_us"))
    return costs_in_words(*(found[name].estimate for name in names))


def _ratio_cells(name: str, of_median: str, of_p90: str) -> dict[str, Cell]:
    return {of_median: interval(f"{name}_median"), of_p90: interval(f"{name}_p90")}


WORTH: dict[str, Cell] = {
    "edge, over uniform": worth("break_even_edge_base"),
    "edge, over the best uniform": worth("break_even_edge_best"),
    "state, over uniform": worth("break_even_state_base"),
    "state, over the best uniform": worth("break_even_state_best"),
    "medians: edge, over uniform": _typical,
}
PAPER: dict[str, Cell] = {
    "path length mean, rad": interval("length_rad_mean"),
    "running time mean, ms": interval("solve_ms_mean"),
    "with the request, ms": interval("total_ms_mean"),
    "success": interval("solved", ".4f"),
    "scenarios always solved": interval("always_solved"),
}
WORK: dict[str, Cell] = {
    f"solved within {WITHIN}": interval(f"within_{WITHIN}", ".4f"),
    "paths rejected": number("rejected"),
    "iterations": quantiles("iterations"),
    **_ratio_cells("iterations_ratio", "of uniform's median", "of its p90"),
    **_ratio_cells("iterations_ratio_own_best", "of its best's median", "of its best's p90"),
    "edge checks": quantiles("edge_checks"),
    **_ratio_cells("edge_checks_ratio", "checks of uniform's median", "checks of its p90"),
    "length of uniform's": interval("length_ratio"),
}
TIME: dict[str, Cell] = {
    "request, ms": quantiles("request_ms", ".2f"),
    "server part": quantiles("server_ms", ".2f"),
    "transport part": quantiles("transport_ms", ".2f"),
    "solve, ms": quantiles("solve_ms", ".2f"),
    "check part": quantiles("check_ms", ".2f"),
    "total, ms": quantiles("total_ms", ".2f"),
}
OPTIMISING: dict[str, Cell] = {
    "came within 5 %": number("close", ".3f"),
    "iterations until then": quantiles("close_iterations"),
    **_ratio_cells("close_iterations_ratio", "of RRT*'s median", "of its p90"),
    "edge checks": quantiles("close_edge_checks"),
    "time, ms": quantiles("close_ms", ".1f"),
    "first length of RRT*'s": interval("first_length_ratio"),
    "last length of the best known": number("final_excess", ".3f"),
}
COUNTS: dict[str, Cell] = {
    **{f"within {count} iterations": interval(f"within_{count}", ".3f") for count in WITHIN_COUNTS},
    "solved": interval("solved", ".4f"),
    "iterations: a problem's mean": interval("iterations_mean_median", ".0f"),
}
GIVING_UP: dict[str, Cell] = {
    "false successes": lambda found: "{:.0f} of {}".format(
        found["solved"].estimate * found["solved"].count, found["solved"].count
    ),
    "iterations": quantiles("end_iterations"),
    "edge checks": quantiles("end_edge_checks"),
    "time to give up, ms": quantiles("end_total_ms"),
}
SAFETY: dict[str, Cell] = {
    "solved": interval("solved"),
    "refused": number("refused", ".2f"),
    "collide": interval("collide"),
    "deeper than 1 cm": interval("deep"),
    "by meshes": lambda found: interval("meshes", ".2f", "not checked" if "collide" in found else "-")(found),
    "more than with unseen free": interval("more"),
    "search, ms: p50 (p95)": quantiles("search_ms", ".0f", "p95"),
    "scoring, ms": quantiles("score_ms", ".0f", "p95"),
}
CHECKS: dict[str, Cell] = {
    "solved": number("solved", ".2f"),
    "free as it was": number("as_is", ".2f"),
    "states": quantiles("state_checks"),
    **_ratio_cells("states_ratio", "of uniform's median", "of its p90"),
    "edges": quantiles("edge_checks"),
    "iterations": quantiles("iterations"),
    "length of uniform's": interval("length_ratio"),
}
PRICE: dict[str, Cell] = {
    "paths, ms": number("request_ms_median", ".1f"),
    "search with checks, ms": number("solve_ms_median", ".1f"),
    "total by spheres, ms": number("spheres_ms", ".1f"),
    "total by meshes, ms": number("meshes_ms", ".1f", "not checked"),
    "faster than uniform if a check costs": worth("break_even_state_base"),
}


def rows_of(found: Iterable[tuple[Mapping[str, str], Figures]], cells: Mapping[str, Cell]) -> pd.DataFrame:
    """A table with one row for each set of figures, which begins with its names."""
    return pd.DataFrame(
        [{**names, **{head: cell(one) for head, cell in cells.items()}} for names, one in found]
    )


READING = (
    "Values are medians; the 90th percentile stands in round brackets, 95 % limits in square ones: exact "
    "(Clopper-Pearson) for shares, by bootstrap over problems for the rest. A run without success ranks "
    "behind all others; > marks a lower bound. *Paths rejected*: the independent check at ten times the "
    "planner's resolution rejected the path, so the run counts as one without success. Ratios are to the "
    "same planner with uniform samples at the same range; *best* is the uniform arm of that planner with the "
    f"lowest median, over ranges and programs. *Within {WITHIN}* counts iterations."
)
WORTH_NOTE = (
    "If a check costs c, all runs of an arm take (requests + the planner's own work) + checks x c. The table "
    "says for which c the arm with learned samples takes less time than the one with uniform samples, and "
    "less than each uniform arm; c is the cost of an edge check or of a state check. *never* as a limit: "
    "some resampled problem sets never pay. A run without success counts up to its end, which favours the "
    "arm with more of them. The last column takes medians over problems instead of sums."
)
TIME_NOTE = (
    "Check time is the number of checks times the cost of one in a compiled loop on the same problem. "
    "*Server* is the time that the sampler reports (decoding, encoding, generating), *transport* the rest of "
    "the request. Every request sends a picture that is new to the server. Arms with the same request share "
    "it, and each counts its time."
)
OPTIMISING_NOTE = (
    "The best known length of a problem is the shortest path of all arms and runs. An iteration of BIT* is a "
    "drawn state, of which it draws many before it checks an edge: compare it by checks and time."
)
GIVING_UP_NOTE = (
    "These problems have no path, so a success would be false. The effort is until a limit ends the search."
)
TREATED_NOTE = (
    "Beside the same planner with the same samples as they come, run by run under the same seeds: the "
    "other's runs that the arm does not solve, and the runs that only the arm solves."
)
PAPER_NOTE = (
    "Lengths are means over the runs with a path. Times are means over all runs; one without a path counts "
    "up to its limit. Intervals are over scenarios, for success over runs."
)
SAFETY_NOTE = (
    "All arms search alike, with the same draws; they differ in how they treat unseen space. Models refine "
    "their paths and choose the one of the highest confidence instead of the shortest. A path collides where "
    "its true clearance, by the arm's spheres every 0.01 rad, is not above 0; by meshes where convex hulls "
    "of its parts touch. *Solved* and *refused* are shares of the problems; the others ran out of time. "
    "*Collide* is a share of the paths. *More than with unseen free* is the paired difference over problems "
    "that both solve. *Truth where unseen* keeps to the pictures and the truth: what a perfect guess of "
    "unseen space would reach. Square brackets are 95 % limits, exact for shares, by bootstrap over problems "
    "for the rest."
)
CONFIDENCE_NOTE = (
    "From one run at `min_confidence` 0, paths sorted by confidence: only those of the highest confidence "
    "are answers, for at most this share of the problems; all others are refused."
)
VIEWS_NOTE = (
    "1.1 to 1.3 m away, 30 to 60 degrees to the side of the line to the robot, 20 to 40 degrees up, with "
    "noise, the arm in the picture."
)
UNSEEN_NOTE = "Share of the arm that no picture shows, mean along the path."
CHECKS_NOTE = (
    "States and edges are checked in the true scene until the first path, by the project's own RRT-Connect: "
    "with uniform configurations, or with paths that are checked first, and configurations about them where "
    "none is free. *Paths of the truth* are searched for in the true scene: what a perfect picture would "
    "give. Of each problem the median over its runs counts; of these the table shows median and 90th "
    "percentile, where an unsolved problem ranks behind all others (> marks a lower bound)."
)
PRICE_NOTE = (
    "If a state check costs c, a problem takes (reading the picture, paths, the planner's own work) + states "
    "x c. The last column says for which c the paths save time over uniform samples, in sums over the "
    "problems; the two before it are medians at the prices of spheres and meshes."
)
VAMP = (
    "For comparison: vamp's RRT-Connect solves MotionBenchMaker's Panda problems in 35 us at the median "
    "(Thomason, Kingston and Kavraki 2024), with the whole scene known. No learned sampler is faster there."
)


def sample_sections(summary: pd.DataFrame, arms: Sequence[Arm], setting: Setting) -> list[Section]:
    """The tables of the protocols ``families`` and ``paper``, without the empty ones."""
    figures, sections = figures_of(summary), list[Section]()
    for family in dict.fromkeys(summary["family"]):
        own = [(arm, figures[family, arm.name]) for arm in arms if (family, arm.name) in figures]
        first = [(arm, found) for arm, found in own if arm.stop_at_first]
        if family in setting.families.solvable:
            counts = [one for one in first if one[0].group is Group.COUNTS]
            counts.sort(key=lambda one: (one[0].sampler or "", one[0].samples))
            learned = [one for one in first if one[0].sampler is not None]
            optimising = [one for one in own if not one[0].stop_at_first]
            paper = first if setting.protocol is Protocol.PAPER else []
            tables = [
                ("Break-even costs of a check", WORTH_NOTE, _by_arm(learned, WORTH)),
                ("The paper's columns", PAPER_NOTE, _by_arm(paper, PAPER)),
                ("Work", "", _by_arm(first, WORK)),
                ("Samples filtered, ordered, checked", TREATED_NOTE, _treated(first)),
                ("Time", TIME_NOTE, _by_arm(first, TIME)),
                (
                    "Optimising",
                    OPTIMISING_NOTE,
                    _by_arm(optimising, OPTIMISING),
                ),
                ("Samples requested", "", _by_arm(counts, COUNTS)),
            ]
        else:
            tables = [("Giving up", GIVING_UP_NOTE, _by_arm(first, GIVING_UP))]
        sections += [(f"{heading}, {family}", note, table) for heading, note, table in tables]
    return [one for one in sections if len(one[2])]


def _by_arm(found: Iterable[tuple[Arm, Figures]], cells: Mapping[str, Cell]) -> pd.DataFrame:
    return rows_of([({"arm": arm.name}, figures) for arm, figures in found], cells)


def _treated(found: Sequence[tuple[Arm, Figures]]) -> pd.DataFrame:
    """The arms whose samples are treated beside the same planner on the same samples untreated."""
    arms, within, rows = {arm.name: figures for arm, figures in found}, f"within_{WITHIN}", []
    for arm, figures in found:
        plain = plain_arm(arm, [one for one, _ in found])
        if plain is not None:
            solved = (one[within].estimate for one in (figures, arms[plain.name]))
            rows.append(
                {
                    "arm": arm.name,
                    "beside": plain.name,
                    f"solved within {WITHIN}": "{:.4f}, {:.4f}".format(*solved),
                    "its runs lost": f"{figures['treated_lost'].estimate:.0f} of {figures[within].count}",
                    "won": f"{figures['treated_won'].estimate:.0f}",
                    "difference": f"{figures['treated_difference']:.4f}",
                }
            )
    return pd.DataFrame(rows)


def plan_sections(
    summary: pd.DataFrame,
    runs: pd.DataFrame,
    pictures: Sequence[int],
    arms: Sequence[PlanArm],
    setting: Setting,
) -> list[Section]:
    """The tables of the protocol ``plans``, without the empty ones."""
    figures, groups = figures_of(summary), plan_groups(runs, pictures, setting)
    sections: list[Section] = []
    for source, count in _sources(summary, pictures, setting):
        group, name = f"{source}, {count}", f"{source}, {_pictures(count)}"
        found = {
            arm.name: figures[group, arm.name]
            for arm in arms
            if not arm.checked and (group, arm.name) in figures
        }
        problems = max(one["solved"].count for one in found.values())
        heading = f"Without exact checks: {name}, {problems} problem{'s' * (problems > 1)}"
        table = rows_of([({"arm": arm}, one) for arm, one in found.items()], SAFETY)
        sections.append((heading, SAFETY_NOTE, table))
        models = {arm: one for arm, one in found.items() if "calibration_error" in one}
        halves = "; ".join(
            f"{model}: calibration error {one['calibration_error'].estimate:.3f}, "
            f"{one['surer_half_collide']:.2f} of the half with the higher confidence collide"
            for model, one in models.items()
        )
        own = groups[group]
        paired = Paired(own[~own["checked"]])
        table = pd.DataFrame([row for model in models for row in _confidence_rows(paired.of(model), model)])
        sections.append((f"By min_confidence: {name}", f"{CONFIDENCE_NOTE} {halves}.", table))
        rows = []
        for family in dict.fromkeys(own["family"]):
            shares = {arm: _collide(figures.get((f"{family}, {count}", arm), {})) for arm in found}
            rows.append({"family": family, **shares})
        sections.append((f"Collisions by family: {name}", "", pd.DataFrame(rows)))
        rows = []
        for low, high in pairwise(UNSEEN_EDGES):
            measure = f"collide_unseen_{low:.2f}_{high:.2f}"
            if any(measure in one for one in found.values()):
                shares = {arm: _collide(one, measure) for arm, one in found.items()}
                rows.append({"unseen": f"{low:.2f} to {high:.2f}", **shares})
        sections.append((f"Collisions by unseen share: {name}", UNSEEN_NOTE, pd.DataFrame(rows)))
    for count in pictures:
        searched = [
            ({"problems": f"{name} ({one['state_checks_median'].count})", "arm": arm.name}, one)
            for group in groups
            for arm in arms
            if arm.checked and group.endswith(f", {count}") and (one := figures.get((group, arm.name)))
            if (name := group.removesuffix(f", {count}"))
        ]
        for heading, note, cells in (
            ("With exact checks", CHECKS_NOTE, CHECKS),
            ("Time and price of a check", PRICE_NOTE, PRICE),
        ):
            sections.append((f"{heading}: {_pictures(count)}", note, rows_of(searched, cells)))
    return [one for one in sections if len(one[2])]


def _sources(summary: pd.DataFrame, pictures: Sequence[int], setting: Setting) -> list[tuple[str, int]]:
    """Sources of problems and numbers of pictures that have figures without exact checks."""
    known = set(summary.loc[summary["measure"] == "refused", "family"])
    pairs = product(partly_seen(setting.world).sources, pictures)
    return [(source, count) for source, count in pairs if f"{source}, {count}" in known]


def _pictures(count: int) -> str:
    return f"{count} picture{'s' * (count > 1)}"


def _collide(found: Figures, measure: str = "collide") -> str:
    return f"{found[measure].estimate:.2f} ({found[measure].count})" if measure in found else "-"


def _confidence_rows(runs: pd.DataFrame, model: str) -> Iterator[dict[str, str]]:
    curve = confidence_curve(runs)
    for share in SHARES:
        # Up to rounding of k / n.
        for _, last in curve[curve["answered"] <= share + 1e-9].tail(1).iterrows():
            yield {
                "model": model,
                "answered, at most": f"{share:.1f}",
                "answered": f"{last['answered']:.2f}",
                "min_confidence": f"{last['confidence']:.3f}",
                "collide": f"{last['collide']:.3f}",
            }


def break_even_line(summary: pd.DataFrame, arms: Sequence[Arm], setting: Setting) -> str:
    """From which cost of an edge check on learned samples are worth their time, by family and planner."""
    clauses, figures = [], figures_of(summary)
    for family in dict.fromkeys(summary["family"]):
        for arm in arms if family in setting.families.solvable else ():
            found = figures.get((family, arm.name), {})
            wanted = arm.group is Group.LEARNED and arm.learned_share == DEFAULT_SHARE
            if wanted and "break_even_edge_base_from_us" in found:
                words = " / ".join(worth(f"break_even_edge_{name}")(found) for name in ("base", "best"))
                clauses.append(f"{family}, {arm.name}: {words}")
    return (
        "Break-even cost of an edge check, from which learned samples save wall time over the same planner "
        "with uniform samples / over the best uniform planner: "
        f"{'; '.join(clauses) or 'no learned sampler was measured'}."
    )


def collision_line(
    summary: pd.DataFrame, pictures: Sequence[int], arms: Sequence[PlanArm], setting: Setting
) -> str:
    """The share of paths that collide, by source and pictures: with unseen space free, and of each model."""
    figures, clauses = figures_of(summary), []
    shown = [arm.name for arm in arms if not arm.checked and arm.unseen in (None, Unseen.FREE)]
    for source, count in _sources(summary, pictures, setting):
        found = {arm: figures.get((f"{source}, {count}", arm), {}) for arm in shown}
        shares = "; ".join(f"{arm} {one['collide']:.2f}" for arm, one in found.items() if "collide" in one)
        clauses.append(f"{source}, {_pictures(count)}: {shares or 'no paths'}")
    return f"Share of the paths planned without exact checks that collide. {'. '.join(clauses)}."


def about(runs: pd.DataFrame, setting: Setting, manifest: Mapping[str, Any]) -> str:
    """Limits, prices and models in a list."""
    lines = [f"- {setting.split} problems, seed {setting.seed}."]
    search = f"{setting.max_iterations} iterations or {setting.time_limit_s:g} s"
    if setting.protocol is Protocol.PLANS:
        prices = [1e6 * runs[name].median() for name in ("state_check_s", "mesh_check_s")]
        spheres, meshes = ("not measured" if np.isnan(one) else f"{one:.1f} us" for one in prices)
        out = len(runs[runs["status"] == NO_PROBLEM][["family", "problem"]].drop_duplicates())
        lines += [
            f"- Cameras look at the {setting.aim}, from {VIEWS_NOTE}",
            *(
                ["- The robot holds what its goal grasps; planners know this and the table."]
                if setting.held
                else []
            ),
            f"- Paths are searched for {setting.plan_limit_s:g} s; exact checks end after {search}.",
            f"- {out} problems are left out, because their start or goal collides.",
            f"- A state check, median: spheres {spheres}, convex meshes {meshes}.",
        ]
    else:
        lines += [
            f"- A run ends after {search}; after {setting.optimising_iterations} iterations if it optimises.",
            f"- Resolution {setting.resolution_rad} rad a joint, range {setting.range_rad:g} rad.",
        ]
    used = set(runs["sampler"].dropna())
    for name, one in manifest["samplers"].items():
        if name in used:
            what = one["model"] or "bundle"
            lines.append(f"- {name}: {what}, digest {one['digest'][:12]}, transport {one['transport']}.")
    return "\n".join(lines)


def report(
    headline: str,
    facts: str,
    sections: Sequence[Section],
    protocol: Protocol,
    figures: Sequence[str] = (),
    pages: Sequence[str] = (),
) -> str:
    """The whole report in Markdown, the headline first; figures and pages are paths relative to it."""
    parts = [headline, f"# Planning benchmark, protocol `{protocol}`", facts]
    parts.append(VAMP if protocol is Protocol.PLANS else READING)
    shown: set[str] = set()
    for heading, note, table in sections:
        # Each note stands once.
        parts += [f"## {heading}", *([note] if note and note not in shown else []), markdown(table)]
        shown.add(note)
    for heading, paths in (("## Figures", figures), ("## Problems", pages)):
        parts += [heading, *(f"![{Path(path).stem}]({path})" for path in paths)] if paths else []
    return "\n\n".join(parts) + "\n"


def terminal(headline: str, sections: Sequence[Section]) -> str:
    """The same tables for a terminal."""
    tables = [f"{heading}\n{aligned(table)}" for heading, _, table in sections]
    return "\n\n".join([headline, *tables]) + "\n"
