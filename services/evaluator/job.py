"""The evaluation of a registered version: download, measure, decide, record."""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

import pandas as pd

from cspace.bundle import Bundle, load_verified
from cspace.errors import (
    BundleError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
)
from cspace.worlds import robot_digest
from services.evaluator.cluster import on_cluster, spread
from services.evaluator.evaluation import (
    Budget,
    Evaluation,
    Setting,
    Unit,
    UnitResult,
    deciding,
    headline,
    run_unit,
    table_of,
    units,
)
from services.evaluator.gate import (
    Bar,
    Champion,
    Gain,
    Verdict,
    compare,
    decide,
    gated_metrics,
)
from services.evaluator.recalibrate import predicted_reports
from services.evaluator.report import comparison_note, log_evaluation, scenes_text
from services.evaluator.scenes import PackedBundle, bundle_sampler
from services.names import (
    ALIAS_CHAMPION,
    EXPERIMENT,
    TAG_MODEL,
    TAG_PRESET,
    TAG_ROLLED_BACK,
    TAG_STAGE,
    TAG_WORLD,
    recorded_name,
    shown_name,
)
from services.planner.samples import SampleSource
from services.registry.entities import ID, ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import Decision, champions, record_decision
from services.registry.tracking import Tracking

STAGE = "evaluation"
Execute = Callable[[Sequence[Unit], Setting, PackedBundle], Iterator[UnitResult]]
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Request:
    """One evaluation."""

    model: ModelReference
    budget: Budget
    seed: int = 0


@dataclass(frozen=True)
class Outcome:
    """A finished evaluation with its run and the names of the pictures there."""

    version: ModelVersion
    evaluation: Evaluation
    verdict: Verdict
    run_id: str
    figures: tuple[str, ...]


def run_here(work: Sequence[Unit], setting: Setting, packed: PackedBundle) -> Iterator[UnitResult]:
    """Results in the order of the work."""
    return (_run(unit, (setting, packed)) for unit in work)


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


def find_champion(
    registry: ModelRegistry, version: ModelVersion, bundle: Bundle, folder: Path
) -> tuple[Bundle | None, Bar]:
    """The present champion, to be measured on the same scenes, and the bar that lacks this comparison.

    Earlier champions of the robot, but those that were rolled back, count with their recorded metrics, and so
    does a present one that cannot be downloaded into ``folder``.
    """
    left = {one.number for one in registry.versions(version.name) if TAG_ROLLED_BACK in one.tags}
    recorded = {
        decision.version: Champion(decision.version, decision.metrics)
        for decision in champions(registry, version.name)
        if decision.version not in {version.number, *left} and decision.robot == bundle.robot
    }
    earlier = tuple(recorded.values())
    try:
        present = registry.by_alias(version.name, ALIAS_CHAMPION)
    except ModelNotFoundError:
        return None, Bar((), earlier)
    if present.number == version.number:
        return None, Bar((), earlier)
    kept = present.number if present.number in recorded else None
    try:
        champion = load_verified(registry.download(present, folder))
    except RegistryUnavailableError:
        raise
    except (RegistryError, BundleError) as error:
        note = f"{present} can not be measured again ({error.what}): recorded metrics count"
        return None, Bar((), earlier, (note,), kept)
    if (champion.spec.kind, champion.robot) != (bundle.spec.kind, bundle.robot):
        return None, Bar((), earlier, (), kept)
    others = tuple(one for one in earlier if one.version != present.number)
    if champion.digest == bundle.digest:
        note = f"the champion, version {present.number}, is this very bundle"
        return None, Bar((), others, (note,), present.number)
    return champion, Bar((), others, (), present.number)


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
            setting = Setting(spec.world, request.seed, request.budget, spec.kind == "path")
            progress(f"evaluating {version}, digest {bundle.digest[:12]}")
            progress(scenes_text(setting))
            champion, bar = find_champion(registry, version, bundle, Path(folder) / "champion")
            rival = f"version {bar.against}, the present champion"
            evaluation = _measure(execute, setting, str(version), bundle, champion, rival, progress)
            if champion is not None:
                compared = compare(evaluation, rival)
                # A recalibrated version counts the outcomes that it was calibrated by.
                if predicted := predicted_reports(bundle, champion, tracking):
                    gain = Gain("log loss of reported plans", *predicted)
                    compared = replace(compared, gains=(*compared.gains, gain))
                bar = replace(bar, comparisons=(compared,))
            verdict = decide(evaluation, bar)
            figures = log_evaluation(run, evaluation, verdict, bundle_sampler(bundle))
        _record(registry, version, evaluation, verdict, progress)
    return Outcome(version, evaluation, verdict, run.run_id, figures)


def _measure(
    execute: Execute,
    setting: Setting,
    model: str,
    bundle: Bundle,
    champion: Bundle | None,
    rival: str,
    progress: Progress,
) -> Evaluation:
    """The version on all scenes, the champion, named ``rival``, on those that decide."""

    def run(work: Sequence[Unit], setting: Setting, measured: Bundle) -> Iterator[UnitResult]:
        for number, result in enumerate(execute(work, setting, PackedBundle.pack(measured)), start=1):
            unit = result.unit
            what = f"{unit.task} {unit.family}, {unit.split}"
            progress(f"{number:3d}/{len(work)}  {what}, {unit.count} in {result.seconds:.1f} s")
            yield result

    results = list(run(units(setting), setting, bundle))
    tables = [table_of(results, model)]
    if champion is not None:
        progress(f"measuring {rival}, on the same scenes")
        # The candidate's scenes, seen by the champion's camera.
        seen = replace(cast("Any", setting.world), sensor=cast("Any", champion.spec.world).sensor)
        theirs = replace(setting, world=seen, budget=replace(setting.budget, narrow_scenarios=0))
        tables.append(table_of(list(run(deciding(units(setting)), theirs, champion)), rival))
    cpu_s = sum(one.seconds for one in results)
    return Evaluation(setting, model, pd.concat(tables, ignore_index=True), cpu_s)


def _record(
    registry: ModelRegistry,
    version: ModelVersion,
    evaluation: Evaluation,
    verdict: Verdict,
    progress: Progress,
) -> None:
    """Append the decision to the version's log, move the alias if it is a promotion, show the figures."""
    setting, metrics = evaluation.setting, gated_metrics(evaluation)
    digest = robot_digest(setting.world)
    moment_ms = time.time_ns() // 1_000_000
    decided = (verdict.promoted, verdict.reasons, metrics, verdict.bar.against, moment_ms, digest)
    record_decision(registry, Decision(version.name, version.number, *decided))
    try:
        registry.show(
            version,
            headline(evaluation),
            comparison_note(evaluation, verdict),
            f"{setting.world.kind} scenes, seed {setting.seed}",
            sha256(scenes_text(setting).encode()).hexdigest(),
        )
    except RegistryUnavailableError:
        raise
    except RegistryError as error:
        # The decision stands without figures and note on the version's page.
        progress(f"the figures are not shown with {version}: {error.what}")
