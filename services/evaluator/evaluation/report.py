"""What an evaluation records: the tracking run with report and pictures, and the decision on the version."""

import json
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.errors import EvaluationError
from cspace.simulator import UNIFORM, Split
from cspace.worlds import picture_of, robot_digest, simulator_of
from services.evaluator.evaluation.gate import (
    Bar,
    Candidate,
    Comparison,
    PathCandidate,
    Verdict,
    path_verdict_of,
    verdict_of,
)
from services.evaluator.evaluation.measured import (
    Measured,
    comparison_table,
    flat_metrics,
    headline,
    measured,
    occupancy_table,
    planning_table,
    reconstruction_table,
    run_metrics,
    scene_family_table,
    topology_table,
)
from services.evaluator.evaluation.units import (
    EVALUATED_SPLITS,
    Evaluation,
    Setting,
    SplitResult,
    planned,
    planner_of,
    planner_seed,
)
from services.evaluator.measures.occupancy import reliability_diagram
from services.evaluator.measures.planning import UNIFORM_SHARE, learned_samples
from services.evaluator.measures.sample_quality import NEIGHBOURS, covered
from services.evaluator.measures.scenes import Scene, Stage, unfiltered
from services.evaluator.tables import Table, aligned, markdown
from services.names import NOTE as DESCRIPTION
from services.planner.ompl_planner import solve
from services.planner.plotting import plot_plan
from services.planner.samples import BundleSampler, SampleSource
from services.registry.entities import ModelVersion, Shown
from services.registry.models import ModelRegistry
from services.registry.promotion import Decision, record_decision
from services.registry.tracking import RunLog

GRID = 160
SHOWN_SAMPLES = 1000
FREE_COLOUR, COLLISION_COLOUR, MISSED_COLOUR = "#1f77b4", "#d62728", "#ff9f1c"
END_COLOUR = "#2ca02c"
POINTS = (
    ("sample", FREE_COLOUR, "o", 3),
    ("sample in collision", COLLISION_COLOUR, "o", 4),
    ("free, no sample within {} rad", MISSED_COLOUR, "s", 4),
    ("start and goal of the family's problem", END_COLOUR, "X", 7),
)


def gallery(
    scenes: Sequence[Scene], sampler: SampleSource, title: str, notes: Sequence[str] | None = None
) -> Figure:
    """One row a scenario: the picture, the true free space, the samples with both kinds of mistakes marked.

    A mistake is a sample in collision, or a free configuration that no sample is near. Of more than two
    joints the first two are shown, without the second kind, which a projection would hide. Each scenario's
    name is followed by its note.
    """
    figure = Figure(figsize=(9.0, 0.7 + 2.9 * len(scenes)), dpi=110, layout="constrained")
    panels = figure.subplots(len(scenes), 3, squeeze=False)
    for row, scene, note in zip(panels, scenes, notes or [""] * len(scenes), strict=True):
        _picture(row[0], scene, note)
        _truth(row[1], scene)
        _samples(row[2], scene, sampler)
    figure.suptitle(title)
    radius_rad = scenes[0].measures.coverage_radius_rad
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=size, ls="", label=label.format(radius_rad))
        for label, colour, marker, size in POINTS
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
    return figure


def completions(scenes: Sequence[Scene], bundle: Bundle, title: str) -> Figure:
    """One row a scenario from the side: what cameras see, and what the bundle expects among the obstacles."""
    figure = Figure(figsize=(7.5, 0.7 + 2.9 * len(scenes)), dpi=110, layout="constrained")
    panels = figure.subplots(len(scenes), 2, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        _picture(row[0], scene, "red is seen, grey is not")
        found = bundle.belief(scene.image)
        (left, _, low), (x, _, z) = found.low_m, found.cell_m * np.array(found.occupied.shape)
        extent = (left, left + x, low, low + z)
        most = found.occupied.max(axis=1).T
        shown = row[1].imshow(most, "Purples", vmin=0.0, vmax=1.0, extent=extent, origin="lower")
        simulator_of(scene.stage.world).draw_scene(row[1], scene.scenario, "none")
        row[1].set(xlim=extent[:2], ylim=extent[2:])
        row[1].set_title("expected by the model,\nwith the outlines of what is there", fontsize=9)
        figure.colorbar(shown, ax=row[1], label="highest probability\nalong the view")
    figure.suptitle(title)
    return figure


def _picture(axes: Axes, scene: Scene, note: str) -> None:
    simulator_of(scene.stage.world).draw_picture(axes, scene.image)
    family = "" if scene.family == UNIFORM else f"{scene.family} "
    name = f"{scene.stage.split}, {family}scenario {scene.index}"
    axes.set_title(f"{name}\n{note}" if note else name, fontsize=9)


def _truth(axes: Axes, scene: Scene) -> None:
    if scene.space.dim == 2:
        free_map(axes, scene)
        axes.set_title(f"truth: grey is in collision{_passage(scene)}", fontsize=9)
    else:
        real = scene.free(SHOWN_SAMPLES, scene.rng(7))
        axes.scatter(*_plane(real), s=2, color=FREE_COLOUR, linewidths=0)
        shown = ", joints 1 and 2" if scene.space.dim > 1 else ""
        axes.set_title(f"free configurations{shown}", fontsize=9)
    if scene.problem is not None:
        ends = np.stack([scene.problem.start, scene.problem.goal])
        look: dict[str, Any] = {"marker": "X", "color": END_COLOUR, "edgecolors": "white"}
        axes.scatter(*_plane(ends), s=50, clip_on=False, zorder=3, **look)
    _joint_axes(axes, scene)


def _passage(scene: Scene) -> str:
    return "" if scene.problem is None else f"\n{scene.problem.passage}"


def _samples(axes: Axes, scene: Scene, sampler: SampleSource) -> None:
    samples = unfiltered(sampler, scene.image, SHOWN_SAMPLES, scene.sampler_seed())
    free = scene.checker.valid_batch(samples)
    held_out = scene.free(SHOWN_SAMPLES, scene.rng(0))
    reached = covered(held_out, samples, scene.space, scene.measures.coverage_radius_rad)
    if scene.space.dim == 2:
        free_map(axes, scene)
        missed = held_out[~reached]
        axes.scatter(missed[:, 0], missed[:, 1], s=9, marker="s", color=MISSED_COLOUR, linewidths=0)
    for mask, colour, size in ((free, FREE_COLOUR, 2), (~free, COLLISION_COLOUR, 5)):
        axes.scatter(*_plane(samples[mask]), s=size, color=colour, linewidths=0)
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


RECONSTRUCTION_NOTE = (
    "Precision is the exact collision-free share. k-NN precision and recall (Kynkaanniemi et al. 2019) are "
    "shares inside the other group's manifold, a union of balls on the torus that reach as far as neighbour "
    f"{NEIGHBOURS}; the row real is what two real samples of this size have of each other."
)
FAMILY_NOTE = (
    "Only the uniform scenarios decide. {} EDr is relative to uniform samples on the same scenarios."
)
COMPARISON_NOTE = (
    "Both on the same scenes and problems with the same seeds. The gain is above 0 where the version is "
    "better, with the limits of the paired difference by bootstrap; of edge checks it is the share saved. As "
    "served: filtered at the model's own threshold."
)
PLANNING_NOTE = (
    "RRT, range {0.range_rad} rad, resolution {0.resolution_rad} rad a joint, at most "
    "{0.max_iterations} iterations. Medians, the 90th percentile in brackets; a run without success "
    "is censored and ranks last, and a value with > is a lower bound. The saved factor is uniform's median "
    "over learned's, the filter factor learned's over that of the samples that pass the validity head (below "
    "1 the filter costs work), paired; time is without drawing the samples."
)
OCCUPANCY_NOTE = (
    "On uniform configurations, predicted free at a confidence of 0.5. The row confident above holds as many "
    "samples as the others: further ones are drawn until enough reach the bundle's threshold, and accepted "
    "is the share that does. The row is missing where in some scenario too few do."
)
TOPOLOGY_NOTE = (
    "The floor is the same score between two real samples. gsc_boundary takes both complements from the "
    "points, gsc_true the real one from its collision states. The scores are blind to position: read them "
    "with precision and coverage."
)


def to_json(evaluation: Evaluation) -> str:
    """Everything, down to the rows behind the summaries."""
    return json.dumps(
        asdict(evaluation) | {"planner": asdict(planner_of(evaluation.setting.world))}, indent=1
    )


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


def _tables(evaluation: Evaluation) -> Iterator[tuple[str, str, Table, str]]:
    """Heading in the report, name in a terminal (empty: not shown there), rows and note of every table."""
    simulator = simulator_of(evaluation.setting.world)
    for name, split, role in (
        ("validation", evaluation.validation, "decides"),
        ("test", evaluation.test, "reported only"),
    ):
        if split.reconstruction is not None:
            gain = f"Gain in precision over uniform: {split.reconstruction.precision_gain:.3f}."
            note = f"{gain}\n\n{RECONSTRUCTION_NOTE}"
            yield f"Reconstruction, {name} ({role})", name, reconstruction_table(split), note
        heading, note = f"Reconstruction by family, {name} (reported only)", simulator.families.note
        yield heading, f"by family, {name}", scene_family_table(split), FAMILY_NOTE.format(note)
        head = occupancy_table(split, simulator.measures.near_contact_m)
        yield f"Validity head, {name}", f"validity head, {name}", head, OCCUPANCY_NOTE
        if split.planning:
            shown = f"planning, {name}" if name == "validation" else ""
            note = PLANNING_NOTE.format(planner_of(evaluation.setting.world))
            yield f"Planning, {name} ({role})", shown, planning_table(split.planning), note
    if evaluation.topology:
        heading = "Topology, test (reported only)"
        yield heading, "topology, test", topology_table(evaluation), TOPOLOGY_NOTE


def to_markdown(
    evaluation: Evaluation, title: str, reasons: Sequence[str], comparisons: Sequence[Comparison] = ()
) -> str:
    """The report: scenes, decision, comparisons, reconstruction, planning, topology."""
    budget = evaluation.setting.budget
    parts = [f"# {title}", _sentence(evaluation.setting), "## Decision", _list(reasons)]
    for one in comparisons:
        heading = f"## Beside {one.rival}, validation (decides)"
        parts += [heading, markdown(comparison_table(one)), COMPARISON_NOTE]
    for heading, _, rows, note in _tables(evaluation):
        parts += [f"## {heading}", markdown(rows), note] if rows else []
    scenes = f"{budget.scenarios} scenarios a split, {budget.samples} samples each"
    if evaluation.validation.reconstruction is None:
        scenes = f"{budget.validation_problems} validation and {budget.test_problems} test problems a family"
    parts.append(
        f"Seed {evaluation.setting.seed}, {scenes}; intervals of 95 % by bootstrap over scenarios, exact for "
        "success rates."
    )
    return "\n\n".join(parts) + "\n"


def terminal_table(evaluation: Evaluation, comparisons: Sequence[Comparison] = ()) -> str:
    """The deciding numbers as aligned text."""
    tables = [(name, rows) for _, name, rows, _ in _tables(evaluation) if name and rows]
    tables += [(f"beside {one.rival}, validation", comparison_table(one)) for one in comparisons]
    return "\n\n".join(f"{name}\n{aligned(rows)}" for name, rows in tables)


def _sentence(setting: Setting) -> str:
    scenes = scenes_text(setting)
    return f"{scenes[0].upper()}{scenes[1:]}."


def _list(reasons: Sequence[str]) -> str:
    return "\n".join(f"- {reason}" for reason in reasons)


MEASURES_TABLE, COMPARISONS, NOTE = "measures", "comparisons", "comparison.md"


def measure_columns(evaluation: Evaluation) -> Mapping[str, Sequence[Any]]:
    """Every estimate, one row each.

    The columns by which MLflow shows runs side by side, ``estimate`` and ``shown``, then the fields of
    :class:`services.evaluator.evaluation.measured.Measured`.
    """
    rows = measured(evaluation)
    shown = {"estimate": [row.title for row in rows], "shown": [str(row) for row in rows]}
    return shown | {field.name: [getattr(row, field.name) for row in rows] for field in fields(Measured)}


def comparison_columns(comparisons: Sequence[Comparison]) -> Mapping[str, Sequence[Any]]:
    """Every gated measure of the version and of each rival, with the limits of the gain."""
    rows = [
        (one.rival, gain.name, gain.ours, gain.theirs, gain.gain.estimate, gain.gain.low, gain.gain.high)
        for one in comparisons
        for gain in one.gains
    ]
    names = ("rival", "measure", "version", "theirs", "gain", "low", "high")
    return dict(pd.DataFrame(rows, columns=list(names)).to_dict("list"))


def comparison_note(evaluation: Evaluation, verdict: Verdict, title: str) -> str:
    """In Markdown what the gate decided and why, and the version beside its rivals."""
    decided = "promoted" if verdict.promoted else "not promoted"
    parts = [f"## {title}: {decided}", _list(verdict.reasons)]
    for one in verdict.bar.comparisons:
        parts += [f"### Beside {one.rival}", markdown(comparison_table(one))]
    if verdict.bar.comparisons:
        parts.append(COMPARISON_NOTE)
    card = f"Model card: `python -m services.evaluator card {title}`."
    return "\n\n".join([*parts, _sentence(evaluation.setting), card]) + "\n"


def shown_of(evaluation: Evaluation, note: str) -> Shown:
    """What a version's page shows, its run and its logged model."""
    setting = evaluation.setting
    name, digest = f"{setting.world.kind} scenes, seed {setting.seed}", sha256(scenes_text(setting).encode())
    return Shown(headline(evaluation), note, name, digest.hexdigest())


# The first scenarios of the uniform family; with the least precise one of every family they make a gallery.
GALLERY_SCENARIOS = 2
REPORT_FOLDER = "report"


def decide(evaluation: Evaluation, bar: Bar) -> Verdict:
    """The gate's verdict."""
    measures = simulator_of(evaluation.setting.world).measures
    found = evaluation.validation.reconstruction
    if found is None:
        return path_verdict_of(_path_candidate(evaluation), bar, measures)
    candidate = Candidate(found.precision_gain, found.real.coverage.estimate, _gated(evaluation))
    return verdict_of(candidate, bar, measures)


def _path_candidate(evaluation: Evaluation) -> PathCandidate:
    planning, trials = evaluation.validation.planning, evaluation.validation.trials
    decisive = simulator_of(evaluation.setting.world).families.decisive
    found = next((family for family in planning if family.family == decisive), None)
    if found is None:
        raise EvaluationError(
            f"path models are evaluated on {decisive} problems", expected="one or more", got="none"
        )
    solved = sum(trial.uniform.success for trial in trials) / len(trials)
    return PathCandidate(decisive, found.edge_checks_ratio, solved, _gated(evaluation))


def record(
    registry: ModelRegistry, version: ModelVersion, evaluation: Evaluation, verdict: Verdict
) -> Decision:
    """Append the decision to the version's log and move the alias if it is a promotion."""
    now_ms = time.time_ns() // 1_000_000
    decision = Decision(
        version.name,
        version.number,
        verdict.promoted,
        verdict.reasons,
        _gated(evaluation),
        verdict.bar.against,
        now_ms,
        robot_digest(evaluation.setting.world),
    )
    record_decision(registry, decision)
    return decision


def log_evaluation(
    run: RunLog, evaluation: Evaluation, verdict: Verdict, sampler: SampleSource, title: str
) -> tuple[str, ...]:
    """Metrics, settings, report and pictures into a run; returns the pictures' names."""
    setting = evaluation.setting
    run.params({"seed": setting.seed, **asdict(setting.budget)})
    run.metrics(run_metrics(evaluation), 0)
    note = comparison_note(evaluation, verdict, title)
    run.tags({"promoted": str(verdict.promoted).lower(), DESCRIPTION: note})
    run.table(measure_columns(evaluation), MEASURES_TABLE)
    if verdict.bar.comparisons:
        run.table(comparison_columns(verdict.bar.comparisons), COMPARISONS)
    with tempfile.TemporaryDirectory(prefix="cspace-report-") as folder:
        texts = {
            "evaluation.md": to_markdown(evaluation, title, verdict.reasons, verdict.bar.comparisons),
            "evaluation.json": to_json(evaluation),
            NOTE: note,
        }
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        run.artifact(Path(folder), REPORT_FOLDER)
        run.flush()
    if sampler.with_ends:
        return _plans(run, evaluation, sampler, title)
    names = []
    for split, result in ((Split.VALIDATION, evaluation.validation), (Split.TEST, evaluation.test)):
        stage = Stage(setting.world, split, setting.seed)
        shown = exhibits(stage, result)
        names.append(f"gallery-{split}")
        run.figure(gallery([*shown], sampler, title, [*shown.values()]), names[-1])
        if isinstance(sampler, BundleSampler) and sampler.bundle.tells_belief:
            names.append(f"completions-{split}")
            run.figure(completions([*shown], sampler.bundle, title), names[-1])
    summary = evaluation.test.reconstruction
    if summary is not None and summary.occupancy is not None:
        names.append("reliability")
        run.figure(reliability_diagram(summary.occupancy, title), names[-1])
    return tuple(names)


def _plans(run: RunLog, evaluation: Evaluation, sampler: SampleSource, title: str) -> tuple[str, ...]:
    """The first test problem of each family, solved with the model's samples."""
    names, setting = [], evaluation.setting
    for family in (summary.family for summary in evaluation.test.planning):
        index = min(trial.index for trial in evaluation.test.trials if trial.family == family)
        problem = simulator_of(setting.world).problem(family, Split.TEST, setting.seed, index)
        seed = planner_seed(setting.seed, 0, 0)
        samples = learned_samples(problem, picture_of(problem.scenario), seed, sampler)
        settings = replace(planner_of(setting.world), seed=seed)
        plan = solve(problem, settings, samples, UNIFORM_SHARE, keep_tree=True)
        names.append(f"plan-{family}")
        run.figure(plot_plan(problem, plan, samples, f"{title}, {family}"), names[-1])
    return tuple(names)


def exhibits(stage: Stage, measured: SplitResult) -> dict[Scene, str]:
    """The scenarios of a gallery with a note on each: some as they come, then the least precise by family."""
    shown: dict[Scene, str] = {}
    for family in simulator_of(stage.world).families.names:
        mine = [row for row in measured.scenes if row.family == family]
        worst = min(mine, key=lambda row: row.sampler.precision, default=None)
        if family == UNIFORM:
            shown |= {Scene(stage, row.index): "" for row in mine[:GALLERY_SCENARIOS]}
        if worst is not None:
            shown[Scene(stage, worst.index, family)] = f"least precise of {len(mine)}"
    return shown


def _gated(evaluation: Evaluation) -> dict[str, float]:
    metrics, measures = flat_metrics(evaluation), simulator_of(evaluation.setting.world).measures
    names = measures.path_margins if evaluation.validation.reconstruction is None else measures.margins
    return {name: metrics[name] for name in names if name in metrics}
