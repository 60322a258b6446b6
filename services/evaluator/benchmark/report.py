"""The benchmark's report: break-even first, then the tables of every arm."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from services.evaluator.benchmark.arms import DEFAULT_SHARE, Arm, Group, Protocol
from services.evaluator.benchmark.results import Convergence, FamilyResult, Results
from services.evaluator.benchmark.summary import (
    WITHIN,
    ArmSummary,
    Flags,
    PairedRuns,
    Ratios,
    costs_in_words,
    in_words,
)
from services.evaluator.evaluation.measured import Table, aligned, markdown
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    clopper_pearson,
    difference_interval,
    mean_interval,
    quantile_interval,
    ratio_of_sums_interval,
)


def table_of(rows: Sequence[Mapping[str, str]]) -> Table:
    """The table of rows whose cells are named by their headings, the same in each; empty without rows."""
    return [list(rows[0]), *(list(row.values()) for row in rows)] if rows else []


def arm_table(summaries: Sequence[ArmSummary]) -> Table:
    """Iterations, checks, success and length of every arm."""
    return table_of(
        [
            {
                "arm": one.arm.name,
                f"solved within {WITHIN}": f"{one.within:.4f}",
                "paths rejected": str(one.rejected),
                "iterations": quantiles(one.iterations),
                **_pair("of uniform's median", "of its p90", one.iteration_ratios),
                **_pair("of its best's median", "of its best's p90", one.own_best_ratios),
                "edge checks": quantiles(one.edge_checks),
                **_pair("checks of uniform's median", "checks of its p90", one.check_ratios),
                "length of uniform's": _interval(one.length_ratio),
            }
            for one in summaries
        ]
    )


def time_table(summaries: Sequence[ArmSummary]) -> Table:
    """Request, solve and whole time of every arm; in brackets the 90th percentile."""
    rows = []
    for one in summaries:
        parts = {name: f"{median:.2f} ({p90:.2f})" for name, (median, p90) in one.parts_ms.items()}
        request = dict.fromkeys(parts, "-") if one.arm.sampler is None else parts
        rows.append(
            {
                "arm": one.arm.name,
                "request, ms": request["request"],
                "of it server": request["server"],
                "of it transport": request["transport"],
                "solve, ms": quantiles(one.solve_ms, ".2f"),
                "of it checks": parts["check"],
                "whole, ms": quantiles(one.total_ms, ".2f"),
            }
        )
    return table_of(rows)


def worth_table(summaries: Sequence[ArmSummary]) -> Table:
    """From which cost of a check on learned samples save wall time."""
    return table_of(
        [
            {
                "arm": one.arm.name,
                "edge, over uniform": in_words(one.worth.edge_base),
                "edge, over the best uniform": in_words(one.worth.edge_best),
                "state, over uniform": in_words(one.worth.state_base),
                "state, over the best uniform": in_words(one.worth.state_best),
                "medians: edge, over uniform": costs_in_words(one.worth.edge_base.typical),
            }
            for one in summaries
            if one.worth is not None
        ]
    )


def convergence_table(found: Sequence[Convergence]) -> Table:
    """How soon optimising planners come within 5 % of the best known length."""
    rows = []
    for one in found:
        time_ms = replace(one.time_s, median=1e3 * one.time_s.median, p90=1e3 * one.time_s.p90)
        rows.append(
            {
                "arm": one.arm.name,
                "came within 5 %": f"{one.close:.3f}",
                "iterations until then": quantiles(one.iterations),
                **_pair("of RRT*'s median", "of its p90", one.iteration_ratios),
                "edge checks": quantiles(one.edge_checks),
                "time, ms": quantiles(time_ms, ".1f"),
                "first length of RRT*'s": _interval(one.first_length),
                "last length of the best known": f"{one.final_excess:.3f}",
            }
        )
    return table_of(rows)


def give_up_table(runs: PairedRuns, arms: Sequence[Arm]) -> Table:
    """Of problems without a path: false successes, and what it takes until a limit ends the search."""
    rows = [["arm", "false successes", "iterations", "edge checks", "time to give up, ms"]]
    for arm in arms:
        solved = runs.solved(arm.name)
        # Every run is cut off here, and where is the very thing that is measured.
        spent = [runs.values(arm.name, name) for name in ("iterations", "edge_checks", "total_s")]
        cells = [
            f"{scale * np.median(values):.0f} ({scale * np.quantile(values, 0.9):.0f})"
            for values, scale in zip(spent, (1.0, 1.0, 1e3), strict=True)
        ]
        rows.append([arm.name, f"{int(solved.sum())} of {solved.size}", *cells])
    return rows


def quantiles(summary: CensoredSummary, form: str = ".0f") -> str:
    """Median and 90th percentile, each with > where it is only a lower bound."""
    median, p90 = (
        f"{'>' if bound else ''}{value:{form}}"
        for value, bound in ((summary.median, summary.median_is_bound), (summary.p90, summary.p90_is_bound))
    )
    return f"{median} ({p90})"


def _pair(of_median: str, of_p90: str, ratios: Ratios | None) -> dict[str, str]:
    median, p90 = (None, None) if ratios is None else (ratios.median, ratios.p90)
    return {of_median: _interval(median), of_p90: _interval(p90)}


def _interval(interval: Interval | None) -> str:
    return "-" if interval is None else f"{interval:.2f}"


def treated_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """What a treatment of the samples does to success, run by run on the same problem under the same seed.

    The interval of the difference is over problems, whose runs stay together.

    Args:
        runs: of one family.
        arms: that were run.
        rng: source of the resampling.
    """
    rows = []
    for arm in arms:
        plain = plain_arm(arm, arms)
        if plain is None:
            continue
        mine, others = (_within(runs, one.name) for one in (arm, plain))
        difference = difference_interval(mine.mean(axis=1), others.mean(axis=1), rng)
        rows.append(
            {
                "arm": arm.name,
                "beside": plain.name,
                f"solved within {WITHIN}": f"{mine.mean():.4f}, {others.mean():.4f}",
                "its runs lost": f"{int((others & ~mine).sum())} of {mine.size}",
                "won": str(int((mine & ~others).sum())),
                "difference": f"{difference:.4f}",
            }
        )
    return table_of(rows)


def plain_arm(arm: Arm, arms: Sequence[Arm]) -> Arm | None:
    """The arm that takes the samples as they come and is else the same; None if there is none."""
    if not _treated(arm):
        return None
    plain = (one for one in arms if one.group is Group.LEARNED and not _treated(one))
    return next((one for one in plain if _planning(one) == _planning(arm)), None)


def _treated(arm: Arm) -> bool:
    return arm.min_confidence > 0.0 or arm.ordered or arm.colliding_last


def _planning(arm: Arm) -> tuple[object, ...]:
    return (arm.planner, arm.sampler, arm.learned_share, arm.samples, arm.epsilon_sigma, arm.stop_at_first)


def _within(runs: PairedRuns, arm: str) -> Flags:
    return runs.solved(arm) & (runs.values(arm, "iterations") <= WITHIN)


WITHIN_COUNTS = (100, 300, 1000)


def paper_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """Path length, running time and success of every arm over all scenarios.

    Lengths are means over the runs with a path. The time is that of the search and, beside it, with the
    request; its means are over all runs, one without a path counted up to its limit. Intervals are over
    scenarios, for success exact over runs.
    """
    rows = []
    for arm in arms:
        solved = runs.solved(arm.name)
        lengths = np.where(solved, np.nan_to_num(runs.values(arm.name, "length_rad")), 0.0).sum(axis=1)
        found = solved.sum(axis=1)
        some = found > 0
        mean_length = "-"
        if some.any():
            mean_length = f"{ratio_of_sums_interval(lengths[some], found[some], rng):.2f}"
        search_ms, whole_ms = (
            mean_interval(1e3 * runs.values(arm.name, name).mean(axis=1), rng)
            for name in ("solve_s", "total_s")
        )
        rows.append(
            {
                "arm": arm.name,
                "path length mean, rad": mean_length,
                "running time mean, ms": f"{search_ms:.2f}",
                "with the request, ms": f"{whole_ms:.2f}",
                "success": f"{clopper_pearson(int(solved.sum()), solved.size):.4f}",
                "scenarios always solved": f"{int(solved.all(axis=1).sum())} of {len(solved)}",
            }
        )
    return table_of(rows)


def counts_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """Success and iterations against the number of samples asked for; empty without such arms.

    Iterations are means over the runs of a problem, of which the median is told; a run without success counts
    as much as the longest.
    """
    swept = sorted(
        (arm for arm in arms if arm.group is Group.COUNTS), key=lambda arm: (arm.sampler, arm.samples)
    )
    rows = []
    for arm in swept:
        solved, iterations = runs.solved(arm.name), runs.values(arm.name, "iterations")
        within = {
            count: clopper_pearson(int((solved & (iterations <= count)).sum()), solved.size)
            for count in WITHIN_COUNTS
        }
        ranked = np.where(solved, iterations, iterations.max()).mean(axis=1)
        rows.append(
            {
                "arm": arm.name,
                "samples": str(arm.samples),
                **{f"within {count} iterations": f"{share:.3f}" for count, share in within.items()},
                "solved": f"{clopper_pearson(int(solved.sum()), solved.size):.4f}",
                "iterations: a problem's mean": f"{quantile_interval(ranked, 0.5, rng):.0f}",
            }
        )
    return table_of(rows)


READING = (
    "Values are medians with the 90th percentile in round brackets and 95 % limits in square ones: exact "
    "(Clopper-Pearson) for shares, by bootstrap over problems for the rest. A run without success ranks "
    "behind all others and is never dropped; > marks a value that is only a lower bound. *Paths rejected*:"
    " by the independent check at ten times the planner's resolution, which makes a run one without "
    "success. Ratios are to the same planner with uniform samples at the same range; *best* is the uniform"
    f" arm of that planner with the lowest median, over ranges and programs. *Within {WITHIN}* counts "
    "iterations. The filtered arms take samples that the validity head lets pass."
)
WORTH = (
    "With checks that cost c a piece, all runs of an arm take (requests + the planner's own work) + checks"
    " x c. The table says for which c the arm with learned samples takes less time than the one with "
    "uniform samples, and less than each uniform arm; c is the cost of an edge, or of a look at one state."
    " *never* as a limit: in some of the resampled problem sets it never does. A run without success "
    "counts up to where it ended, which favours the arm that has more of them. The last column takes "
    "medians over problems instead of sums."
)
TIME = (
    "Checks are counted and multiplied by what one takes in a compiled loop on the same problem; *server* "
    "is what the sampler tells of its own time (decoding, encoding, generating), *transport* the rest of "
    "the request. Every request sends a picture that the server does not know yet. Arms that ask for the "
    "same samples share one request, and each counts it."
)

OPTIMISING = (
    "The best known length of a problem is the shortest that any arm found in any run of it. An iteration "
    "of BIT* is a drawn state, of which it draws many before it looks at an edge: compare it by checks and"
    " time."
)
GIVING_UP = (
    "There is no path, so a success would be false; what is told is the effort until a limit ends the search."
)
TREATED = (
    "Beside the same planner with the same sampler's samples as they come, run by run under the same seeds: "
    "how many of the other's runs the arm does not solve, and how many it solves that the other does not."
)
PAPER = (
    "Lengths are means over the runs with a path. Times are means over all runs, one without a path "
    "counted up to its limit. Intervals are over scenarios, for success over runs."
)


def comparison_note(results: Results) -> str:
    """The short form: what a check must cost for samples to pay, and a table of the arms by family."""
    parts = [break_even_line(results)]
    for name, found in results.families.items():
        parts += [f"### {name}", markdown(arm_table(found.summaries))]
    return "\n\n".join(parts) + "\n"


def report(
    results: Results, manifest: Mapping[str, Any], figures: Sequence[str] = (), pages: Sequence[str] = ()
) -> str:
    """The whole report; its first line is the break-even cost of a check.

    Args:
        results: of the benchmark.
        manifest: of its folder.
        figures: paths of the figures, as seen from the report.
        pages: likewise, of the pages of single problems.
    """
    title = f"# Planning benchmark, protocol `{results.setting.protocol}`"
    parts = [break_even_line(results), title, _about(results, manifest), READING]
    for found in results.families.values():
        parts += _family(found, results)
    for heading, paths in (("## Figures", figures), ("## Problems", pages)):
        parts += [heading, *(f"![{Path(path).stem}]({path})" for path in paths)] if paths else []
    return "\n\n".join(parts) + "\n"


def break_even_line(results: Results) -> str:
    """From which cost of an edge check on learned samples are worth their time, by family and planner."""
    clauses = []
    for found in results.families.values():
        for one in found.summaries if found.solvable else ():
            wanted = one.arm.group is Group.LEARNED and one.arm.learned_share == DEFAULT_SHARE
            if wanted and one.worth is not None:
                same, best = in_words(one.worth.edge_base), in_words(one.worth.edge_best)
                clauses.append(f"{found.family}, {one.arm.name}: {same} / {best}")
    told = "; ".join(clauses) or "no learned sampler was measured"
    return (
        "Break-even cost of an edge check, from which learned samples save wall time over the same planner "
        f"with uniform samples / over the best uniform planner: {told}."
    )


def terminal_tables(results: Results) -> str:
    """The same tables, aligned."""
    parts = [break_even_line(results)]
    for found in results.families.values():
        parts += [f"{found.family}: {name}\n{aligned(table)}" for name, table, _ in _tables(found, results)]
    return "\n\n".join(parts) + "\n"


def _about(results: Results, manifest: Mapping[str, Any]) -> str:
    setting = results.setting
    limits = (
        f"- {setting.split} problems, seed {setting.seed}; at most {setting.max_iterations} iterations and "
        f"{setting.time_limit_s:g} s a run, {setting.optimising_iterations} iterations where the search goes "
        f"on after its first solution; resolution {setting.resolution_rad} rad a joint, goal bias "
        f"{setting.goal_bias}; ranges as named, else 1 rad."
    )
    lines, used = [limits], {arm.sampler for arm in results.arms}
    for name, one in manifest["samplers"].items():
        if name in used:
            what = one["model"] or "bundle"
            lines.append(f"- {name}: {what}, digest {one['digest'][:12]}, transport {one['transport']}.")
    return "\n".join(lines)


def _family(found: FamilyResult, results: Results) -> list[str]:
    counts = f"{len(found.runs.problems)} problems, {len(found.runs.numbers)} runs each"
    parts = [f"## {found.family}: {counts}"]
    for name, table, note in _tables(found, results):
        parts += [f"### {name}, {found.family}", *([note] if note else []), markdown(table)]
    return parts


def _tables(found: FamilyResult, results: Results) -> list[tuple[str, Table, str]]:
    """Name, rows and note of the tables of a family, without the empty ones."""
    arms = [one.arm for one in found.summaries]
    if not found.solvable:
        return [("Giving up", give_up_table(found.runs, arms), GIVING_UP)]
    rng = np.random.default_rng(results.setting.seed)
    paper = paper_table(found.runs, arms, rng) if results.setting.protocol is Protocol.PAPER else []
    tables = [
        ("Break-even costs of a check", worth_table(found.summaries), WORTH),
        ("The paper's columns", paper, PAPER),
        ("Work", arm_table(found.summaries), ""),
        ("Samples filtered, ordered, checked", treated_table(found.runs, arms, rng), TREATED),
        ("Time", time_table(found.summaries), TIME),
        ("Optimising", convergence_table(found.convergence), OPTIMISING),
        ("Samples asked for", counts_table(found.runs, arms, rng), ""),
    ]
    return [one for one in tables if len(one[1]) > 1]
