"""The evaluation of a registered version: download, measure, decide, record."""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import pandas as pd

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.dataset import open_dataset
from cspace.errors import ConfigError, RegistryError, RegistryUnavailableError
from cspace.worlds import robot_digest
from services.evaluator.cluster import on_cluster, spread
from services.evaluator.evaluation import Evaluation, table_of
from services.evaluator.gate import Comparison, Gain, Verdict, compare, decide, gated_metrics
from services.evaluator.measure import (
    BUDGETS,
    MAX_SEED,
    Budget,
    Setting,
    Unit,
    UnitResult,
    deciding,
    run_unit,
    units,
)
from services.evaluator.recalibrate import predicted_reports
from services.evaluator.report import comparison_note, log_evaluation, scenes_text, shown_of
from services.evaluator.rivals import Rival, find_rivals
from services.evaluator.scenes import PackedBundle, bundle_sampler
from services.names import EXPERIMENT, TAG_MODEL, TAG_PRESET, TAG_STAGE, TAG_WORLD, recorded_name, shown_name
from services.planner.samples import SampleSource
from services.registry.entities import ID, ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import Decision, record_decision
from services.registry.tracking import Tracking

STAGE = "evaluation"
Execute = Callable[[Sequence[Unit], Setting, PackedBundle], Iterator[UnitResult]]
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Request:
    """One evaluation; ``promote`` records the decision and moves the alias.

    ``data`` is a data set whose held-out scenes replace those of the version's own data. Without ``shipped``,
    the folder of the shipped model, the version is not compared with it.
    """

    model: ModelReference
    budget: Budget
    seed: int = 0
    promote: bool = True
    data: Path | None = None
    shipped: Path | None = None


def make_request(
    model: str, *, budget: str = "quick", scenarios: int | None = None, **others: Any
) -> Request:
    """A request from the command line; ``scenarios`` per split replace those of the budget."""
    if scenarios is not None and scenarios < 1:
        raise ConfigError("there are too few scenarios", expected="at least 1", got=str(scenarios))
    chosen = BUDGETS[budget] if scenarios is None else replace(BUDGETS[budget], scenarios=scenarios)
    request = Request(ModelReference.parse_version(model, "the model reference is unknown"), chosen, **others)
    if not 0 <= request.seed <= MAX_SEED:
        raise ConfigError("the seed is out of range", expected=f"0 to {MAX_SEED}", got=str(request.seed))
    return request


@dataclass(frozen=True)
class Outcome:
    """A finished evaluation with its run and the names of the pictures there.

    ``recorded`` says whether the decision was recorded, and the alias moved if it was a promotion.
    """

    version: ModelVersion
    evaluation: Evaluation
    verdict: Verdict
    recorded: bool
    run_id: str
    figures: tuple[str, ...]


def run_here(work: Sequence[Unit], setting: Setting, packed: PackedBundle) -> Iterator[UnitResult]:
    """Results in the order of the work."""
    for unit in work:
        yield _run(unit, (setting, packed))


def run_on_ray(work: Sequence[Unit], setting: Setting, packed: PackedBundle) -> Iterator[UnitResult]:
    """Results as they come from the cluster that RAY_ADDRESS names."""
    return spread(_run, work, (setting, packed), "evaluation")


def executor(environment: Mapping[str, str]) -> Execute:
    """Over the cluster where RAY_ADDRESS names one; its http form is for submitting jobs only."""
    return run_on_ray if on_cluster(environment) else run_here


def _run(unit: Unit, shared: tuple[Setting, PackedBundle]) -> UnitResult:
    setting, packed = shared
    return run_unit(unit, setting, _sampler(packed))


@lru_cache(maxsize=1)
def _sampler(packed: PackedBundle) -> SampleSource:
    """A worker process loads and verifies a bundle once."""
    return bundle_sampler(packed.load())


def evaluate_version(
    request: Request,
    tracking: Tracking,
    registry: ModelRegistry,
    execute: Execute = run_here,
    progress: Progress = print,
) -> Outcome:
    """Evaluate a version, log it beside its training, and let the gate decide.

    The numbers are the same in this process and over a cluster; ``progress`` takes lines for people.
    """
    version = registry.look_up(request.model)
    name = f"{version} judged, seed {request.seed}, {ID}"
    tags = {TAG_STAGE: STAGE, TAG_MODEL: str(version), "model_digest": version.digest}
    tags |= {TAG_PRESET: version.tags.get(TAG_PRESET, "")}
    with tempfile.TemporaryDirectory(prefix="cspace-evaluation-") as folder:
        bundle = load_verified(registry.download(version, Path(folder) / "bundle"))
        # Training registers under its parent run, under which the trials are shown as well.
        with tracking.start(EXPERIMENT, name, parent_run_id=version.run_id, tags=tags) as run:
            spec = bundle.spec
            robot = shown_name(spec.world, recorded_name(spec.provenance.config))
            run.tags({TAG_WORLD: f"{spec.world.kind}, {robot}"})
            world = spec.world
            if request.data is not None:
                data = open_dataset(request.data, verify=False)
                world = world.among(data.world, data.arrays)
            setting = Setting(world, request.seed, request.budget, spec.kind == "path")
            progress(f"evaluating {version}, digest {bundle.digest[:12]}")
            progress(scenes_text(setting))
            rivals, bar = find_rivals(registry, version, bundle, request.shipped, Path(folder) / "rivals")
            work = units(setting)
            results = _measure(execute, work, setting, PackedBundle.pack(bundle), progress)
            tables = [table_of(results, str(version))]
            for rival in rivals:
                progress(f"measuring {rival.name}, on the same scenes")
                # The candidate's scenes, seen by the rival's camera.
                seen = replace(cast("Any", world), sensor=rival.world.sensor)
                theirs = replace(setting, world=seen, budget=replace(setting.budget, narrow_scenarios=0))
                rows = _measure(execute, deciding(work), theirs, rival.packed, progress)
                tables.append(table_of(rows, rival.name))
            cpu_s = sum(one.seconds for one in results)
            evaluation = Evaluation(setting, str(version), pd.concat(tables, ignore_index=True), cpu_s)
            compared = tuple(
                _with_reports(compare(evaluation, rival.name), bundle, rival, tracking)
                if rival.version == bar.against
                else compare(evaluation, rival.name)
                for rival in rivals
            )
            verdict = decide(evaluation, replace(bar, comparisons=compared))
            figures = log_evaluation(run, evaluation, verdict, bundle_sampler(bundle))
        if request.promote:
            _record(registry, version, evaluation, verdict)
            _show(registry, version, evaluation, verdict, progress)
    return Outcome(version, evaluation, verdict, request.promote, run.run_id, figures)


def _with_reports(comparison: Comparison, bundle: Bundle, champion: Rival, tracking: Tracking) -> Comparison:
    """The comparison of a recalibrated version counts the outcomes that it was calibrated by."""
    predicted = predicted_reports(bundle, champion.packed.load(), tracking)
    if predicted is None:
        return comparison
    gain = Gain("log loss of reported plans", *predicted)
    return replace(comparison, gains=(*comparison.gains, gain))


def _measure(
    execute: Execute, work: Sequence[Unit], setting: Setting, packed: PackedBundle, progress: Progress
) -> list[UnitResult]:
    results: list[UnitResult] = []
    for result in execute(work, setting, packed):
        results.append(result)
        unit = result.unit
        what = f"{unit.task} {unit.family}, {unit.split}"
        progress(f"{len(results):3d}/{len(work)}  {what}, {unit.count} in {result.seconds:.1f} s")
    return results


def _record(registry: ModelRegistry, version: ModelVersion, evaluation: Evaluation, verdict: Verdict) -> None:
    """Append the decision to the version's log and move the alias if it is a promotion."""
    decision = Decision(
        version.name,
        version.number,
        verdict.promoted,
        verdict.reasons,
        gated_metrics(evaluation),
        verdict.bar.against,
        time.time_ns() // 1_000_000,
        robot_digest(evaluation.setting.world),
    )
    record_decision(registry, decision)


def _show(
    registry: ModelRegistry,
    version: ModelVersion,
    evaluation: Evaluation,
    verdict: Verdict,
    progress: Progress,
) -> None:
    """Figures and note on the version's page; the decision stands without them."""
    try:
        registry.show(version, shown_of(evaluation, comparison_note(evaluation, verdict)))
    except RegistryUnavailableError:
        raise
    except RegistryError as error:
        progress(f"the figures are not shown with {version}: {error.what}")
