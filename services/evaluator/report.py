"""What an evaluation records in MLflow and prints: metrics, tables, report and pictures."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.simulator import UNIFORM
from cspace.worlds import robot_digest, simulator_of
from services.evaluator.evaluation import (
    ESTIMATE_COLUMNS,
    EVALUATED_SPLITS,
    TEST,
    VALIDATION,
    Evaluation,
    Setting,
    planned,
    planner_of,
    run_metrics,
)
from services.evaluator.gate import Comparison, Verdict
from services.evaluator.metrics import Task
from services.evaluator.metrics.coverage import covered
from services.evaluator.scenes import Scene, Stage, unfiltered
from services.names import NOTE as DESCRIPTION
from services.planner.samples import SampleSource
from services.registry.tracking import RunLog

MEASURES_TABLE, COMPARISONS, NOTE = "measures", "comparisons", "comparison.md"
REPORT_FOLDER = "report"
# The first of every family.
GALLERY_SCENARIOS = 2
COMPARISON_NOTE = """\
Both on the same scenes and problems with the same seeds. The gain is above 0 where the version is better,
with the limits of the paired difference by bootstrap; of edge checks it is the share saved. As served:
filtered at the model's own threshold."""
MEASURES_NOTE = """\
Only validation decides, of scenes the uniform ones. docs/method.md defines the measures. Planning is by RRT,
range {0.range_rad} rad, resolution {0.resolution_rad} rad a joint, at most {0.max_iterations} iterations. A
run without success counts as the most expensive one. Ratios: uniform samples' median over that of these."""


def scenes_text(setting: Setting) -> str:
    """In one line the scenes on which a version is evaluated: world, families, how many, seed."""
    world, budget = setting.world, setting.budget
    there = [simulator_of(world).count(split) or budget.scenarios for split in EVALUATED_SPLITS]
    validation, test = (min(budget.scenarios, count) for count in there)
    uniform = f"{validation} validation and {test} test scenes of the family uniform, "
    problems = f"{budget.validation_problems} validation and {budget.test_problems} test problems"
    known = simulator_of(world).families
    return (
        f"evaluated on scenes of the {world.kind} world with {known.uniform_obstacles} "
        f"(robot {robot_digest(world)[:12]}, "
        f"{world.dim} joints): {'' if setting.paths else uniform}{problems} of each family "
        f"({', '.join(planned(known))}), seed {setting.seed}"
    )


def shown(value: float, low: float, high: float, digits: str = ".4f") -> str:
    """An estimate with its limits, if it has any."""
    return f"{value:{digits}}" + ("" if pd.isna(low) else f" [{low:{digits}}, {high:{digits}}]")


def measure_columns(evaluation: Evaluation) -> Mapping[str, Sequence[Any]]:
    """Every estimate, one row each; MLflow shows runs side by side by ``estimate`` and ``shown``."""
    rows = evaluation.estimates
    titles = rows[["split", "family", "sampler", "task", "measure"]].apply(
        lambda row: " ".join(filter(None, row)), axis=1
    )
    texts = [shown(*limits) for limits in zip(rows["value"], rows["low"], rows["high"], strict=True)]
    table = pd.DataFrame({"estimate": titles, "shown": texts, **rows[ESTIMATE_COLUMNS]}).astype(object)
    return {str(name): column.tolist() for name, column in table.where(table.notna(), None).items()}


def comparison_table(comparison: Comparison) -> pd.DataFrame:
    """Every gated measure of the version and of a rival, the gain with its limits, and what that means."""
    words = {(True, False): "better", (False, True): "worse", (False, False): "within the interval"}
    rows = [
        (gain.name, gain.ours, gain.theirs, *astuple(gain.gain)[:3], words[gain.better, gain.worse])
        for gain in comparison.gains
    ]
    return pd.DataFrame(rows, columns=["measure", "version", "theirs", "gain", "low", "high", "verdict"])


def comparison_note(evaluation: Evaluation, verdict: Verdict) -> str:
    """In Markdown what the gate decided and why, and the version beside its rivals."""
    title, decided = evaluation.model, "promoted" if verdict.promoted else "not promoted"
    parts = [f"## {title}: {decided}", "\n".join(f"- {reason}" for reason in verdict.reasons)]
    for one in verdict.bar.comparisons:
        parts += [f"### Beside {one.rival}", comparison_table(one).to_markdown(index=False, floatfmt=".4f")]
    if verdict.bar.comparisons:
        parts.append(COMPARISON_NOTE)
    scenes = scenes_text(evaluation.setting)
    return "\n\n".join([*parts, f"{scenes[0].upper()}{scenes[1:]}."]) + "\n"


def _tables(evaluation: Evaluation, *, everything: bool) -> Iterator[tuple[str, Task, pd.DataFrame]]:
    """Split, task and a table with a row for each family and sampler, of all or of the main estimates."""
    rows = evaluation.estimates
    rows = rows if everything else rows[rows["main"]]
    texts = [shown(*one, ".4g") for one in zip(rows["value"], rows["low"], rows["high"], strict=True)]
    rows = rows.assign(text=texts, family=rows["family"].replace("", "all"))
    for split in (VALIDATION, TEST):
        for task in Task:
            mine = rows[(rows["split"] == split) & (rows["task"] == task)]
            wide = {
                (family, sampler): dict(zip(group["measure"], group["text"], strict=True))
                for (family, sampler), group in mine.groupby(["family", "sampler"], sort=False)
            }
            if wide:
                table = pd.DataFrame.from_dict(wide, orient="index").fillna("-")
                yield split, task, table.rename_axis(["family", "samples"]).reset_index()


def to_markdown(evaluation: Evaluation, verdict: Verdict) -> str:
    """The report: decision, comparisons, scenes, and every estimate."""
    setting, budget = evaluation.setting, evaluation.setting.budget
    parts = [comparison_note(evaluation, verdict).rstrip()]
    for split, task, table in _tables(evaluation, everything=True):
        text = table.to_markdown(index=False, disable_numparse=True)
        parts += [f"## {task.capitalize()}, {split}", text]
    scenes = f"{budget.scenarios} scenarios a split, {budget.samples} samples each"
    if setting.paths:
        scenes = f"{budget.validation_problems} validation and {budget.test_problems} test problems a family"
    parts += [
        MEASURES_NOTE.format(planner_of(setting.world)),
        simulator_of(setting.world).families.note,
        f"Seed {setting.seed}, {scenes}; intervals of 95 % by bootstrap over scenarios, exact for success.",
    ]
    return "\n\n".join(parts) + "\n"


def terminal_table(evaluation: Evaluation, comparisons: Sequence[Comparison] = ()) -> str:
    """The main estimates as aligned text."""
    tables = [(f"{task}, {split}", table) for split, task, table in _tables(evaluation, everything=False)]
    tables += [(f"beside {one.rival}, validation", comparison_table(one)) for one in comparisons]
    return "\n\n".join(
        f"{name}\n{table.to_string(index=False, float_format='%.4f')}" for name, table in tables
    )


def log_evaluation(
    run: RunLog, evaluation: Evaluation, verdict: Verdict, sampler: SampleSource
) -> tuple[str, ...]:
    """Metrics, settings, report and pictures into a run; returns the pictures' names."""
    setting = evaluation.setting
    run.params({"seed": setting.seed, **asdict(setting.budget)})
    run.metrics(run_metrics(evaluation), 0)
    note = comparison_note(evaluation, verdict)
    run.tags({"promoted": str(verdict.promoted).lower(), DESCRIPTION: note})
    run.table(measure_columns(evaluation), MEASURES_TABLE)
    if verdict.bar.comparisons:
        tables = [comparison_table(one).assign(rival=one.rival) for one in verdict.bar.comparisons]
        run.table(dict(pd.concat(tables).to_dict("list")), COMPARISONS)
    with tempfile.TemporaryDirectory(prefix="cspace-report-") as temporary:
        folder = Path(temporary)
        (folder / "evaluation.md").write_text(to_markdown(evaluation, verdict), encoding="utf-8")
        (folder / NOTE).write_text(note, encoding="utf-8")
        evaluation.table.to_parquet(folder / "evaluation.parquet")
        run.artifact(folder, REPORT_FOLDER)
    # Path models are evaluated by planning alone, and have no samples to show.
    return () if sampler.with_ends else _log_galleries(run, evaluation, sampler)


def _log_galleries(run: RunLog, evaluation: Evaluation, sampler: SampleSource) -> tuple[str, ...]:
    """The first scenarios of every family, a picture for each split."""
    names, setting = [], evaluation.setting
    for split in EVALUATED_SPLITS:
        stage = Stage(setting.world, split, setting.seed)
        rows = evaluation.select(split, Task.RECONSTRUCTION)[["family", "number"]].drop_duplicates()
        first = rows.sort_values("number").groupby("family", sort=False).head(GALLERY_SCENARIOS)
        scenes = [Scene(stage, int(number), str(family)) for family, number in first.to_numpy()]
        names.append(f"gallery-{split}")
        run.figure(gallery(scenes, sampler, evaluation.model), names[-1])
    return tuple(names)


GRID = 160
SHOWN_SAMPLES = 1000
FREE_COLOUR, COLLISION_COLOUR, MISSED_COLOUR = "#1f77b4", "#d62728", "#ff9f1c"
END_COLOUR = "#2ca02c"


def gallery(scenes: Sequence[Scene], sampler: SampleSource, title: str) -> Figure:
    """One row a scenario: the picture, the true free space, the samples with both kinds of mistakes marked.

    A mistake is a sample in collision, or a free configuration that no sample is near. Of more than two
    joints the first two are shown, without the second kind, which a projection would hide.
    """
    figure = Figure(figsize=(9.0, 0.7 + 2.9 * len(scenes)), dpi=110, layout="constrained")
    panels = figure.subplots(len(scenes), 3, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        _picture(row[0], scene)
        _truth(row[1], scene)
        _samples(row[2], scene, sampler)
    figure.suptitle(title)
    found = [axes.get_legend_handles_labels() for axes in panels.flat]
    handles = {name: handle for one in found for handle, name in zip(*one, strict=True)}
    look: dict[str, Any] = {"loc": "outside lower center", "ncols": len(handles), "frameon": False}
    figure.legend(list(handles.values()), list(handles), fontsize=8, markerscale=2.0, **look)
    return figure


def _picture(axes: Axes, scene: Scene) -> None:
    simulator_of(scene.stage.world).draw_picture(axes, scene.image)
    family = "" if scene.family == UNIFORM else f"{scene.family} "
    axes.set_title(f"{scene.stage.split}, {family}scenario {scene.index}", fontsize=9)


def _truth(axes: Axes, scene: Scene) -> None:
    if scene.space.dim == 2:
        free_map(axes, scene)
        axes.set_title("truth: grey is in collision", fontsize=9)
    else:
        real = scene.free(SHOWN_SAMPLES, scene.rng(7))
        axes.scatter(*_plane(real), s=2, color=FREE_COLOUR, linewidths=0)
        shown = ", joints 1 and 2" if scene.space.dim > 1 else ""
        axes.set_title(f"free configurations{shown}", fontsize=9)
    if scene.problem is not None:
        ends = np.stack([scene.problem.start, scene.problem.goal])
        look: dict[str, Any] = {"marker": "X", "color": END_COLOUR, "edgecolors": "white"}
        label = "start and goal of the family's problem"
        axes.scatter(*_plane(ends), s=50, clip_on=False, zorder=3, label=label, **look)
    _joint_axes(axes, scene)


def _samples(axes: Axes, scene: Scene, sampler: SampleSource) -> None:
    samples = unfiltered(sampler, scene.image, SHOWN_SAMPLES, scene.sampler_seed())
    free, radius_rad = scene.checker.valid_batch(samples), scene.measures.coverage_radius_rad
    held_out = scene.free(SHOWN_SAMPLES, scene.rng(0))
    reached = covered(held_out, samples, scene.space, radius_rad)
    shown = [(samples[free], FREE_COLOUR, 2, "sample")]
    shown.append((samples[~free], COLLISION_COLOUR, 5, "sample in collision"))
    if scene.space.dim == 2:
        free_map(axes, scene)
        shown.insert(0, (held_out[~reached], MISSED_COLOUR, 9, f"free, no sample within {radius_rad} rad"))
    for points, colour, size, label in shown:
        axes.scatter(*_plane(points), s=size, color=colour, linewidths=0, label=label)
    shares = f"{free.mean():.1%} free, {reached.mean():.1%} covered"
    axes.set_title(f"{len(samples)} samples\n{shares}", fontsize=9)
    _joint_axes(axes, scene)


def _plane(configurations: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The first two joints of (n, d), (n,) each; a single one lies on a line."""
    first = configurations[:, 0]
    return first, configurations[:, 1] if configurations.shape[1] > 1 else np.zeros_like(first)


def free_map(axes: Axes, scene: Scene) -> None:
    """White where free, grey in collision."""
    first, second = (
        np.linspace(low, high, GRID) for low, high in zip(scene.space.lower, scene.space.upper, strict=True)
    )
    grid: NDArray[np.float64] = np.stack(np.meshgrid(first, second), axis=-1).reshape(-1, 2)
    free = scene.checker.valid_batch(grid).reshape(GRID, GRID)
    extent = (first[0], first[-1], second[0], second[-1])
    axes.imshow(free, extent=extent, origin="lower", cmap="gray", vmin=-2.0, vmax=1.0, aspect="auto")


def _joint_axes(axes: Axes, scene: Scene) -> None:
    space = scene.space
    for joint, axis in enumerate((axes.xaxis, axes.yaxis)[: space.dim]):
        if space.periodic[joint]:
            axis.set_ticks([-np.pi, 0.0, np.pi], labels=["-\u03c0", "0", "\u03c0"])
        axis.set_label_text(f"theta{joint + 1} [rad]")
    axes.set_box_aspect(1.0)
    axes.set_xlim(space.lower[0], space.upper[0])
    if space.dim > 1:
        axes.set_ylim(space.lower[1], space.upper[1])
    else:
        axes.yaxis.set_ticks([])
