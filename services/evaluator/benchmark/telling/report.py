"""The benchmark for readers: break-even first, then what every arm did."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from services.evaluator.benchmark.runs.arms import DEFAULT_SHARE, Group
from services.evaluator.benchmark.runs.setting import Protocol
from services.evaluator.benchmark.summary.break_even import in_words
from services.evaluator.benchmark.summary.results import FamilyResult, Results
from services.evaluator.benchmark.summary.summaries import WITHIN
from services.evaluator.benchmark.telling.paper import counts_table, paper_table
from services.evaluator.benchmark.telling.rows import (
    arm_table,
    convergence_table,
    give_up_table,
    time_table,
    worth_table,
)
from services.evaluator.benchmark.telling.treated import treated_table
from services.evaluator.evaluation.tables import Table, aligned, markdown

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
