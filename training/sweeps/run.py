"""A sweep from its grid to its table: what has finished stays, the rest runs side by side."""

import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from services.evaluator.evaluation.tables import aligned, markdown
from services.names import EXPERIMENT
from services.registry.tracking.experiment import TAG_STAGE
from services.registry.tracking.mlflow_tracking import MlflowTracking
from services.registry.tracking.port import ID, RunLog
from training.clusters.stages import prepare_data
from training.jobs.environment import Environment
from training.jobs.folders import job_folder, run_of
from training.jobs.patience import PatientRun, patiently
from training.jobs.provenance import job_tags
from training.jobs.submission import explanation, submission_id
from training.sweeps.grid import Point
from training.sweeps.plan import Plan
from training.sweeps.point_job import PointJob, run_point
from training.sweeps.progress import stage_of
from training.sweeps.record import PointResult, SweepRecord
from training.sweeps.tables import Standing, final_table, progress_lines
from training.trials.launch import connect
from training.trials.points import Look, run_side_by_side
from training.trials.request import stop_file

_LOG = logging.getLogger("training")
LOOK_EVERY_S = 10.0
TABLE = "sweep.md"


def run_sweep(plan: Plan, environment: Environment) -> dict[str, Any]:
    """Run what has not finished, and tell of all; returns what the command prints.

    Raises:
        ConfigError: the sweep's name stands for other settings.
        CspaceError: bad data, or a tracking server that does not answer.
    """
    record = SweepRecord.load(environment.data_folder, plan.name, plan.preset, plan.overrides)
    connect()
    record, run = _open(record, plan, environment)
    with run:
        _LOG.info("run: %s", run.run_id)
        for line in explanation(submission_id()):
            _LOG.info("%s", line)
        run.params({"preset": plan.preset, "set": list(plan.overrides)})
        results = {point: found for point in plan.configs if (found := record.result(point)) is not None}
        kept = {point: found for point, found in results.items() if found.state == "finished"}
        _LOG.info("sweep: %d points, %d have finished before", len(plan.configs), len(kept))
        results = kept | _run_rest(plan, environment, record, kept)
        return _report(plan, run, record.folder, results)


def _open(record: SweepRecord | None, plan: Plan, environment: Environment) -> tuple[SweepRecord, RunLog]:
    tracking, patience_s = MlflowTracking(environment.tracking_uri), environment.patience_s
    if record is None:
        seed = next(iter(plan.configs.values())).seed
        tags = job_tags(plan.preset, seed, "training/sweep.py") | {"sweep": plan.name, TAG_STAGE: "sweep"}
        title, key = f"sweep {plan.name}, {ID}", f"sweep/{plan.name}"
        started = patiently(
            "starting the sweep's run",
            lambda: tracking.start(EXPERIMENT, title, tags=tags, key=key),
            patience_s,
        )
        settings = (environment.data_folder, plan.name, plan.preset, plan.overrides)
        record = SweepRecord.create(*settings, started.run_id)
    run_id = record.run_id
    run = patiently("opening the sweep's run", lambda: tracking.resume(run_id), patience_s)
    return record, PatientRun(run, patience_s)


def _run_rest(
    plan: Plan, environment: Environment, record: SweepRecord, kept: Mapping[Point, PointResult]
) -> dict[Point, PointResult]:
    left = [
        PointJob(
            point,
            config,
            (*plan.overrides, *point.overrides),
            environment,
            record.job_id(point),
            record.run_id,
            plan.scenarios,
            plan.register,
        )
        for point, config in plan.configs.items()
        if point not in kept
    ]
    # Two points that made the same data set at once would write the same files.
    for config in {str(one.config.data_folder or one.config.data.key): one.config for one in left}.values():
        prepare_data(config, environment.data_folder)
    found: dict[Point, PointResult] = {}

    def stop(one: PointJob) -> None:
        run_id = run_of(environment, one.job)
        if run_id is not None:
            stop_file(job_folder(environment, run_id)).touch()

    for look in run_side_by_side(left, run_point, plan.at_once, LOOK_EVERY_S, stop):
        if look.ended is not None:
            one, result = look.ended
            if not isinstance(result, PointResult):
                # Not an error that the project foresees: whoever looks for its cause needs all of it.
                _LOG.warning("%s: %s", one.point.title, result)
                result = PointResult("failed", 0.0, {}, error=_last_line(result))
            record.keep(one.point, result)
            found[one.point] = result
        shown = [_standing(point, {**kept, **found}, look, environment) for point in plan.configs]
        for line in progress_lines(shown, {**kept, **found}, plan.at_once):
            _LOG.info("%s", line)
    return found


def _standing(
    point: Point,
    results: Mapping[Point, PointResult],
    look: Look[PointJob, PointResult],
    environment: Environment,
) -> Standing:
    if point in results:
        return Standing(point, results[point].state)
    for one, since in look.began.items():
        if one.point == point:
            run_id = run_of(environment, one.job)
            doing = "" if run_id is None else stage_of(job_folder(environment, run_id))
            return Standing(point, "running", doing, time.monotonic() - since)
    return Standing(point, "waiting")


def _report(plan: Plan, run: RunLog, folder: Path, results: Mapping[Point, PointResult]) -> dict[str, Any]:
    table = final_table(results, plan.sort)
    for line in aligned(table).splitlines():
        _LOG.info("%s", line)
    (folder / TABLE).write_text(markdown(table) + "\n", encoding="utf-8")
    run.artifact(folder / TABLE)
    failed = sum(result.state != "finished" for result in results.values())
    run.metrics({"points": float(len(results)), "failed": float(failed)}, 0)
    rows = [dict(zip(table[0], row, strict=True)) for row in table[1:]]
    return {"run_id": run.run_id, "job": plan.name, "failed": failed, "points": rows}


def _last_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[-1] if lines else type(error).__name__
