"""The evaluation of a registered version: download, measure, decide, record."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.dataset import open_dataset
from cspace.errors import RegistryError, RegistryUnavailableError
from cspace.world import World
from cspace.worlds import simulator_of
from services.evaluator.cluster import on_cluster, spread
from services.evaluator.evaluation.gate import Comparison, Gain, Verdict, compare_paths, compare_samplers
from services.evaluator.evaluation.report import (
    comparison_note,
    decide,
    log_evaluation,
    record,
    scenes_text,
    shown_of,
)
from services.evaluator.evaluation.rivals import Rival, find_rivals
from services.evaluator.evaluation.units import (
    Evaluation,
    Request,
    Row,
    Setting,
    Unit,
    UnitResult,
    assemble,
    deciding,
    run_unit,
    units,
)
from services.evaluator.measures.scenes import PackedBundle, bundle_sampler, summary_rng
from services.evaluator.recalibrate import predicted_reports
from services.names import EXPERIMENT, TAG_MODEL, TAG_PRESET, TAG_STAGE, TAG_WORLD, recorded_name, shown_name
from services.planner.samples import SampleSource
from services.registry.entities import ID, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking

Execute = Callable[[Sequence[Unit], Setting, PackedBundle], Iterator[UnitResult]]


def run_here(work: Sequence[Unit], setting: Setting, packed: PackedBundle) -> Iterator[UnitResult]:
    """Results in the order of the work."""
    for unit in work:
        yield run_packed(unit, setting, packed)


def run_packed(unit: Unit, setting: Setting, packed: PackedBundle) -> UnitResult:
    """One unit with a bundle that came as bytes; a worker process loads and verifies it once."""
    return run_unit(unit, setting, _sampler(packed))


@lru_cache(maxsize=1)
def _sampler(packed: PackedBundle) -> SampleSource:
    return bundle_sampler(packed.load())


STAGE = "evaluation"
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """A finished evaluation with its tracking run and the names of the pictures there.

    ``recorded`` tells whether the decision was recorded, and the alias moved if it was a promotion.
    """

    version: ModelVersion
    evaluation: Evaluation
    verdict: Verdict
    recorded: bool
    run_id: str
    figures: tuple[str, ...]


def evaluate_version(
    request: Request,
    tracking: Tracking,
    registry: ModelRegistry,
    execute: Execute = run_here,
    progress: Progress = print,
) -> Outcome:
    """Evaluate a version, log it beside its training, and let the gate decide.

    The numbers are the same in this process and over a cluster; ``progress`` takes lines for people.

    Raises:
        ModelNotFoundError: there is no such version.
        BundleError: the version's bundle is damaged.
        CspaceError: measuring or recording failed.
    """
    version = request.model.look_up(registry)
    name = f"{version} judged, seed {request.seed}, {ID}"
    tags = {TAG_STAGE: STAGE, TAG_MODEL: str(version), "model_digest": version.digest}
    tags |= {TAG_PRESET: version.tags.get(TAG_PRESET, "")}
    with tempfile.TemporaryDirectory(prefix="cspace-evaluation-") as folder:
        bundle = load_verified(registry.download(version, Path(folder) / "bundle"))
        # Training registers under its parent run, which the trials are shown under as well.
        with tracking.start(EXPERIMENT, name, parent_run_id=version.run_id, tags=tags) as run:
            spec = bundle.spec
            robot = shown_name(spec.world, recorded_name(spec.provenance.config))
            run.tags({TAG_WORLD: f"{spec.world.kind}, {robot}"})
            world = spec.world if request.data is None else _among(spec.world, request.data)
            setting = Setting(world, request.seed, request.budget, spec.kind == "path")
            progress(f"evaluating {version}, digest {bundle.digest[:12]}")
            progress(scenes_text(setting))
            rivals, bar = find_rivals(registry, version, bundle, request.shipped, Path(folder) / "rivals")
            work = units(setting)
            results = _measure(execute, work, setting, PackedBundle.pack(bundle), progress)
            evaluation = assemble(results, setting)
            compared = tuple(_beside(rival, evaluation, execute, work, progress) for rival in rivals)
            compared = tuple(
                _with_reports(one, bundle, rival, tracking) if rival.version == bar.against else one
                for rival, one in zip(rivals, compared, strict=True)
            )
            verdict = decide(evaluation, replace(bar, comparisons=compared))
            figures = log_evaluation(run, evaluation, verdict, bundle_sampler(bundle), str(version))
        if request.promote:
            record(registry, version, evaluation, verdict)
            _show(registry, version, evaluation, verdict, progress)
    return Outcome(version, evaluation, verdict, request.promote, run.run_id, figures)


def run_on_ray(work: Sequence[Unit], setting: Setting, packed: PackedBundle) -> Iterator[UnitResult]:
    """Results as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    Raises:
        JobError: the cluster does not answer, or a unit failed for good.
        CspaceError: what the unit itself raised.
    """
    return spread(_run, work, (setting, packed), "evaluation")


def executor(environment: Mapping[str, str]) -> Execute:
    """Over the cluster where RAY_ADDRESS names one; its http form is for submitting jobs only."""
    return run_on_ray if on_cluster(environment) else run_here


def _run(unit: Unit, shared: tuple[Setting, PackedBundle]) -> UnitResult:
    return run_packed(unit, *shared)


def _show(
    registry: ModelRegistry,
    version: ModelVersion,
    evaluation: Evaluation,
    verdict: Verdict,
    progress: Progress,
) -> None:
    """Figures and note on the version's page; the decision stands without them."""
    try:
        registry.show(version, shown_of(evaluation, comparison_note(evaluation, verdict, str(version))))
    except RegistryUnavailableError:
        raise
    except RegistryError as error:
        progress(f"the figures are not shown with {version}: {error.what}")


def _among(world: World, folder: Path) -> World:
    data = open_dataset(folder, verify=False)
    return world.among(data.world, data.arrays)


def _measure(
    execute: Execute, work: Sequence[Unit], setting: Setting, packed: PackedBundle, progress: Progress
) -> list[UnitResult]:
    results: list[UnitResult] = []
    for result in execute(work, setting, packed):
        results.append(result)
        unit = result.unit
        what = f"{unit.kind}{f' {unit.family}' if unit.family else ''}, {unit.split}"
        progress(f"{len(results):3d}/{len(work)}  {what}, {unit.count} in {result.seconds:.1f} s")
    return results


def _with_reports(comparison: Comparison, bundle: Bundle, champion: Rival, tracking: Tracking) -> Comparison:
    """The comparison of a recalibrated version counts the outcomes that it was calibrated by."""
    predicted = predicted_reports(bundle, champion.packed.load(), tracking)
    if predicted is None:
        return comparison
    gain = Gain("log loss of reported plans", *predicted)
    return replace(comparison, gains=(*comparison.gains, gain))


def _beside(
    rival: Rival, evaluation: Evaluation, execute: Execute, work: Sequence[Unit], progress: Progress
) -> Comparison:
    """Measure a rival by the units that decide, in the candidate's scenes seen by the rival's camera."""
    progress(f"measuring {rival.name}, on the same scenes")
    setting, validation = evaluation.setting, evaluation.validation
    world = replace(cast("Any", setting.world), sensor=rival.world.sensor)
    seen = replace(setting, world=world, budget=replace(setting.budget, narrow_scenarios=0))
    results = _measure(execute, deciding(work), seen, rival.packed, progress)
    ours: list[Row] = [*validation.scenes, *validation.trials]
    theirs = [row for one in results for row in one.rows]
    rng = summary_rng(setting.seed)
    if setting.paths:
        return compare_paths(rival.name, ours, theirs, simulator_of(world).families.decisive, rng)
    return compare_samplers(rival.name, ours, theirs, rng)
