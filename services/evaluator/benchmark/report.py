"""The benchmark for readers: break-even first, then what every arm did."""

from collections.abc import Mapping
from typing import Any

from services.evaluator.benchmark.arms import DEFAULT_SHARE, Group
from services.evaluator.benchmark.break_even import in_words
from services.evaluator.benchmark.results import FamilyResult, Results
from services.evaluator.benchmark.rows import arm_table, give_up_table, time_table
from services.evaluator.tables import aligned, markdown


def report(results: Results, manifest: Mapping[str, Any]) -> str:
    """The whole report; its first line is the break-even cost of a check."""
    parts = [break_even_line(results), f"# Planning benchmark, protocol {results.setting.protocol}"]
    parts += [_about(results, manifest)]
    for found in results.families.values():
        parts += _family(found)
    return "\n\n".join(parts) + "\n"


def break_even_line(results: Results) -> str:
    """From which cost of an edge check on learned samples are worth their time, by family and planner."""
    clauses = []
    for found in results.families.values():
        for one in found.summaries if found.solvable else ():
            wanted = one.arm.group is Group.LEARNED and one.arm.learned_share == DEFAULT_SHARE
            if wanted and one.break_even_base is not None and one.break_even_best is not None:
                same, best = in_words(one.break_even_base), in_words(one.break_even_best)
                clauses.append(f"{found.family}, {one.arm.name}: {same} / {best}")
    told = "; ".join(clauses) or "no learned sampler was measured"
    return (
        "Break-even cost of an edge check, from which learned samples save wall time over the same planner "
        f"with uniform samples / over the best uniform planner: {told}."
    )


def _about(results: Results, manifest: Mapping[str, Any]) -> str:
    setting = results.setting
    limits = (
        f"- {setting.split} problems, seed {setting.seed}; at most {setting.max_iterations} iterations and "
        f"{setting.time_limit_s:g} s a run, {setting.optimising_iterations} iterations where the search goes "
        f"on after its first solution; resolution {setting.resolution_rad} rad a joint, goal bias "
        f"{setting.goal_bias}; ranges as named, else 1 rad."
    )
    lines = [limits]
    used = {arm.sampler for arm in results.arms}
    for name, one in manifest["samplers"].items():
        if name in used:
            what = one["model"] or "bundle"
            lines.append(f"- {name}: {what}, digest {one['digest'][:12]}, transport {one['transport']}.")
    return "\n".join(lines)


def _family(found: FamilyResult) -> list[str]:
    runs = f"{len(found.runs.problems)} problems, {len(found.runs.numbers)} runs each"
    head = f"## {found.family.value}: {runs}"
    if not found.solvable:
        return [head, markdown(give_up_table(found.summaries))]
    return [head, markdown(arm_table(found.summaries)), markdown(time_table(found.summaries))]


def terminal_tables(results: Results) -> str:
    """The same tables, aligned."""
    parts = [break_even_line(results)]
    for found in results.families.values():
        tables = [arm_table, time_table] if found.solvable else [give_up_table]
        parts += [found.family.value, *(aligned(table(found.summaries)) for table in tables)]
    return "\n\n".join(parts) + "\n"
