"""What an evaluation leaves behind: a tracking run with report and pictures, a decision on the version."""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from cspace.problem import Family
from cspace.scenario import Split
from services.evaluator.budget import SCENE_FAMILIES
from services.evaluator.evaluation import Evaluation
from services.evaluator.gallery import gallery
from services.evaluator.gate import GATED, Candidate, Champion, Verdict, judge
from services.evaluator.metrics import flat_metrics
from services.evaluator.reconstruction import SceneQuality
from services.evaluator.reliability import reliability_diagram
from services.evaluator.report import to_json, to_markdown
from services.evaluator.samplers import Sampler
from services.evaluator.scenes import Scene, Stage
from services.registry.models import ModelRegistry, ModelVersion
from services.registry.promotion import Decision, champions, record_decision
from services.registry.tracking import RunLog

# The first scenarios of the uniform family; with the least precise one of every family they make a gallery.
GALLERY_SCENARIOS = 2
REPORT_FOLDER = "report"
# Only champions of arms with as many joints are compared.
JOINTS = "joints"


def decide(registry: ModelRegistry, version: ModelVersion, evaluation: Evaluation) -> Verdict:
    """The gate's verdict against all earlier champions of the model."""
    joints = evaluation.setting.robot.dim
    earlier = [
        Champion(decision.version, decision.metrics)
        for decision in champions(registry, version.name)
        if decision.version != version.number and decision.metrics.get(JOINTS) == joints
    ]
    gain = evaluation.validation.reconstruction.precision_gain
    return judge(Candidate(gain, _gated(evaluation)), earlier)


def record(
    registry: ModelRegistry, version: ModelVersion, evaluation: Evaluation, verdict: Verdict
) -> Decision:
    """Append the decision to the version's log and move the alias if it is a promotion."""
    metrics = {**_gated(evaluation), JOINTS: float(evaluation.setting.robot.dim)}
    now_ms = time.time_ns() // 1_000_000
    decision = Decision(
        version.name, version.number, verdict.promoted, verdict.reasons, metrics, verdict.against, now_ms
    )
    record_decision(registry, decision)
    return decision


def log_evaluation(
    run: RunLog, evaluation: Evaluation, verdict: Verdict, sampler: Sampler, title: str
) -> tuple[str, ...]:
    """Metrics, settings, report and pictures into a run; returns the pictures' names."""
    setting = evaluation.setting
    run.params({"seed": setting.seed, "scenarios": setting.budget.scenarios, "budget": str(setting.budget)})
    run.metrics(flat_metrics(evaluation), 0)
    run.tags({"promoted": str(verdict.promoted).lower()})
    with tempfile.TemporaryDirectory(prefix="cspace-report-") as folder:
        for name, text in (
            ("evaluation.md", to_markdown(evaluation, title, verdict.reasons)),
            ("evaluation.json", to_json(evaluation)),
        ):
            path = Path(folder) / name
            path.write_text(text, encoding="utf-8")
            run.artifact(path, REPORT_FOLDER)
        run.flush()
    names = []
    for split, measured in ((Split.VALIDATION, evaluation.validation), (Split.TEST, evaluation.test)):
        stage = Stage(setting.robot, setting.camera, split, setting.seed)
        shown = exhibits(stage, measured.scenes)
        names.append(f"gallery-{split}")
        run.figure(gallery([*shown], sampler, title, [*shown.values()]), names[-1])
    head = evaluation.test.reconstruction.occupancy
    if head is not None:
        names.append("reliability")
        run.figure(reliability_diagram(head, title), names[-1])
    return tuple(names)


def exhibits(stage: Stage, measured: Sequence[SceneQuality]) -> dict[Scene, str]:
    """The scenarios of a gallery with a note on each: some as they come, then the least precise by family."""
    shown: dict[Scene, str] = {}
    for family in SCENE_FAMILIES:
        mine = [row for row in measured if row.family is family]
        worst = min(mine, key=lambda row: row.sampler.precision, default=None)
        if family is Family.UNIFORM:
            shown |= {Scene(stage, row.index): "" for row in mine[:GALLERY_SCENARIOS]}
        if worst is not None:
            shown[Scene(stage, worst.index, family)] = f"least precise of {len(mine)}"
    return shown


def _gated(evaluation: Evaluation) -> dict[str, float]:
    metrics = flat_metrics(evaluation)
    return {name: metrics[name] for name in GATED if name in metrics}
