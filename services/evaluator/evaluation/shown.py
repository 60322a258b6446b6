"""What people compare versions by: tables of all estimates, and a note of what changed."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from hashlib import sha256
from typing import Any

from services.evaluator.evaluation.comparison import Comparison
from services.evaluator.evaluation.gate import Verdict
from services.evaluator.evaluation.measured import Measured, measured
from services.evaluator.evaluation.metrics import headline
from services.evaluator.evaluation.report import COMPARISON_NOTE, judged_on
from services.evaluator.evaluation.tables import comparison_table, markdown
from services.evaluator.evaluation.units import Evaluation
from services.registry.models.port import Shown

Columns = Mapping[str, Sequence[Any]]
MEASURES_TABLE, COMPARISONS, NOTE = "measures", "comparisons", "comparison.md"


def measure_columns(evaluation: Evaluation) -> Columns:
    """Every estimate, one row each.

    ``estimate`` and ``shown`` come first, by which the UI sets runs side by side; then the columns of
    :class:`services.evaluator.evaluation.measured.Measured`.
    """
    rows = measured(evaluation)
    told = {"estimate": [row.title for row in rows], "shown": [str(row) for row in rows]}
    return told | {field.name: [getattr(row, field.name) for row in rows] for field in fields(Measured)}


def comparison_columns(comparisons: Sequence[Comparison]) -> Columns:
    """Every gated measure beside each rival, with the limits of what is gained."""
    rows = [
        (one.rival, gain.name, gain.ours, gain.theirs, gain.gain.estimate, gain.gain.low, gain.gain.high)
        for one in comparisons
        for gain in one.gains
    ]
    names = ("rival", "measure", "version", "theirs", "gain", "low", "high")
    return {name: [row[place] for row in rows] for place, name in enumerate(names)}


def comparison_note(evaluation: Evaluation, verdict: Verdict, title: str) -> str:
    """In Markdown what the gate decided and why, and the version beside its rivals."""
    decided = "promoted" if verdict.promoted else "not promoted"
    parts = [f"## {title}: {decided}", "\n".join(f"- {reason}" for reason in verdict.reasons)]
    for one in verdict.bar.comparisons:
        parts += [f"### Beside {one.rival}", markdown(comparison_table(one))]
    if verdict.bar.comparisons:
        parts.append(COMPARISON_NOTE)
    scenes = judged_on(evaluation.setting)
    return "\n\n".join([*parts, f"{scenes[0].upper()}{scenes[1:]}."]) + "\n"


def shown_of(evaluation: Evaluation, note: str) -> Shown:
    """What a version's page shows, its run and its logged model."""
    setting = evaluation.setting
    words = judged_on(setting)
    return Shown(
        headline(evaluation),
        note,
        f"{setting.world.kind} scenes, seed {setting.seed}",
        sha256(words.encode()).hexdigest(),
    )
