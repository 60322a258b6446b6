"""Writes the benchmark of plans: table, report and figure in a folder, and all in a run."""

from dataclasses import asdict

from cspace.errors import StorageError
from services.evaluator.benchmark.plans.checked import ALL
from services.evaluator.benchmark.plans.figure import safety_figure
from services.evaluator.benchmark.plans.record import PlanRun
from services.evaluator.benchmark.plans.report import PlanResults, headline, plan_report
from services.evaluator.benchmark.runs.store import MANIFEST, RunStore
from services.evaluator.benchmark.telling.files import FIGURES, PARQUET, REPORT, STAGE, Saved
from services.evaluator.benchmark.telling.frame import write_parquet
from services.evaluator.benchmark.telling.metrics import metric_name
from services.evaluator.statistics import Interval
from services.names import EXPERIMENT
from services.registry.tracking.experiment import NOTE, TAG_STAGE
from services.registry.tracking.port import ID, Tracking

SAFETY = "safety"


def write_plan_files(results: PlanResults, store: RunStore[PlanRun]) -> None:
    """Writes the table, the figure, and the report that shows it.

    Raises:
        StorageError: a file can not be written.
    """
    out, shown = store.folder, None
    try:
        write_parquet(results.runs, out / PARQUET)
        if results.plans:
            shown = f"{FIGURES}/{SAFETY}.png"
            (out / FIGURES).mkdir(exist_ok=True)
            safety_figure(results.plans).savefig(out / shown)
        (out / REPORT).write_text(plan_report(results, store.manifest(), shown), "utf-8")
    except OSError as error:
        raise StorageError(f"the folder {out} can not be written", got=str(error)) from error


def log_plan_run(tracking: Tracking, results: PlanResults, store: RunStore[PlanRun]) -> str:
    """Settings, metrics and files as a tracking run; its id.

    Raises:
        RegistryError: the server refuses or does not answer.
    """
    setting = results.setting
    name = f"planning, {setting.protocol}, {setting.split}, seed {setting.seed}, {ID}"
    tags = {"protocol": setting.protocol, TAG_STAGE: STAGE}
    with tracking.start(EXPERIMENT, name, tags=tags) as run:
        samplers = {name: one["digest"] for name, one in store.manifest()["samplers"].items()}
        run.params({"setting": asdict(setting), "samplers": samplers})
        run.metrics(plan_metrics(results), 0)
        run.tags({NOTE: headline(results)})
        for part in (MANIFEST, PARQUET, REPORT):
            run.artifact(store.folder / part)
        for path in sorted((store.folder / FIGURES).glob("*.png")):
            run.figure(Saved(path), path.stem)
        run.flush()
        return run.run_id


def plan_metrics(results: PlanResults) -> dict[str, float]:
    """By source, pictures and arm: solved, collide, and states with ways over uniform ones."""
    found: dict[str, float] = {}
    for plans, summaries in zip(results.plans, results.summaries, strict=True):
        for one in summaries:
            place = f"{_group(plans.source, plans.pictures)}/{metric_name(one.arm)}"
            told: dict[str, Interval | None] = {
                "solved": one.solved,
                "collide": one.collide,
                "more": one.more,
            }
            found |= {f"{place}/{name}": part.estimate for name, part in told.items() if part is not None}
        for model in plans.models:
            if (sure := plans.sureness(model)) is not None:
                place = f"{_group(plans.source, plans.pictures)}/{metric_name(model)}"
                found[f"{place}/calibration_error"] = sure.calibration_error
                found[f"{place}/surer_half_collide"] = sure.surer_half.estimate
    for group, checks in zip(results.groups, results.checks, strict=True):
        for one_check in checks if group.name.endswith(f", {ALL}") else ():
            if one_check.ratios is not None:
                name = _group(group.name.removesuffix(f", {ALL}"), group.pictures)
                place = f"{name}/{metric_name(one_check.arm)}"
                found[f"{place}/states_ratio_median"] = one_check.ratios[0].estimate
                found[f"{place}/states_ratio_p90"] = one_check.ratios[1].estimate
    return found


def _group(source: str, pictures: int) -> str:
    return f"{metric_name(source)}_{pictures}"
