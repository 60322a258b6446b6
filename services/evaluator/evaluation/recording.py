"""What an evaluation leaves behind: a tracking run with report and pictures, a decision on the version."""

import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

from cspace.errors import EvaluationError
from cspace.problem import UNIFORM, Problem
from cspace.splits import Split
from cspace.worlds import picture_of, robot_digest, workshop_of
from services.evaluator.evaluation.gallery import gallery
from services.evaluator.evaluation.gate import Bar, Candidate, PathCandidate, Verdict, judge, judge_paths
from services.evaluator.evaluation.metrics import flat_metrics, run_metrics
from services.evaluator.evaluation.report import to_json, to_markdown
from services.evaluator.evaluation.rivals import JOINTS
from services.evaluator.evaluation.shown import (
    COMPARISONS,
    MEASURES_TABLE,
    NOTE,
    comparison_columns,
    comparison_note,
    measure_columns,
)
from services.evaluator.evaluation.units import Evaluation, SplitResult, planner_of, planner_seed
from services.evaluator.measures.planning import UNIFORM_SHARE, learned_samples
from services.evaluator.measures.reliability import reliability_diagram
from services.evaluator.measures.scenes import Scene, Stage
from services.planner.drawing.plot import draw_plan
from services.planner.search.ompl_planner import solve
from services.planner.sources.samples import SampleSource
from services.registry.models.port import ModelRegistry, ModelVersion
from services.registry.promotion import Decision, record_decision
from services.registry.tracking.experiment import NOTE as DESCRIPTION
from services.registry.tracking.port import RunLog

# The first scenarios of the uniform family; with the least precise one of every family they make a gallery.
GALLERY_SCENARIOS = 2
REPORT_FOLDER = "report"


def decide(evaluation: Evaluation, bar: Bar) -> Verdict:
    """The gate's verdict."""
    measures = workshop_of(evaluation.setting.world).measures
    found = evaluation.validation.reconstruction
    if found is None:
        return judge_paths(_path_candidate(evaluation), bar, measures)
    candidate = Candidate(found.precision_gain, found.real.coverage.estimate, _gated(evaluation))
    return judge(candidate, bar, measures)


def _path_candidate(evaluation: Evaluation) -> PathCandidate:
    planning, trials = evaluation.validation.planning, evaluation.validation.trials
    telling = workshop_of(evaluation.setting.world).families.telling
    found = next((family for family in planning if family.family == telling), None)
    if found is None:
        raise EvaluationError(
            f"path models are judged on {telling} problems", expected="one or more", got="none"
        )
    solved = sum(trial.uniform.success for trial in trials) / len(trials)
    return PathCandidate(telling, found.edge_checks_ratio, solved, _gated(evaluation))


def record(
    registry: ModelRegistry, version: ModelVersion, evaluation: Evaluation, verdict: Verdict
) -> Decision:
    """Append the decision to the version's log and move the alias if it is a promotion."""
    metrics = {**_gated(evaluation), JOINTS: float(evaluation.setting.world.dim)}
    now_ms = time.time_ns() // 1_000_000
    decision = Decision(
        version.name,
        version.number,
        verdict.promoted,
        verdict.reasons,
        metrics,
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
    for split, measured in ((Split.VALIDATION, evaluation.validation), (Split.TEST, evaluation.test)):
        stage = Stage(setting.world, split, setting.seed)
        shown = exhibits(stage, measured)
        names.append(f"gallery-{split}")
        run.figure(gallery([*shown], sampler, title, [*shown.values()]), names[-1])
    summary = evaluation.test.reconstruction
    if summary is not None and summary.occupancy is not None:
        names.append("reliability")
        run.figure(reliability_diagram(summary.occupancy, title), names[-1])
    return tuple(names)


def _plans(run: RunLog, evaluation: Evaluation, sampler: SampleSource, title: str) -> tuple[str, ...]:
    """The first test problem of each family, solved with the model's samples."""
    names, setting = [], evaluation.setting
    for summary in evaluation.test.planning:
        family = summary.family
        problem = _first(evaluation.test.problems, family)
        seed = planner_seed(setting.seed, 0, 0)
        image = picture_of(problem.scenario)
        samples = learned_samples(problem, image, seed, sampler)
        plan = solve(
            problem, replace(planner_of(setting.world), seed=seed), samples, UNIFORM_SHARE, keep_tree=True
        )
        names.append(f"plan-{family}")
        run.figure(draw_plan(problem, plan, samples, f"{title}, {family}"), names[-1])
    return tuple(names)


def _first(problems: Mapping[tuple[str, int], Problem], family: str) -> Problem:
    return problems[min(key for key in problems if key[0] == family)]


def exhibits(stage: Stage, measured: SplitResult) -> dict[Scene, str]:
    """The scenarios of a gallery with a note on each: some as they come, then the least precise by family."""
    shown: dict[Scene, str] = {}
    for family in workshop_of(stage.world).families.names:
        mine = [row for row in measured.scenes if row.family == family]
        worst = min(mine, key=lambda row: row.sampler.precision, default=None)
        if family == UNIFORM:
            shown |= {Scene(stage, row.index): "" for row in mine[:GALLERY_SCENARIOS]}
        if worst is not None:
            drawn = measured.problems.get((family, worst.index))
            shown[Scene(stage, worst.index, family, drawn)] = f"least precise of {len(mine)}"
    return shown


def _gated(evaluation: Evaluation) -> dict[str, float]:
    metrics, measures = flat_metrics(evaluation), workshop_of(evaluation.setting.world).measures
    names = measures.path_margins if evaluation.validation.reconstruction is None else measures.margins
    return {name: metrics[name] for name in names if name in metrics}
