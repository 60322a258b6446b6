"""The evaluation of a registered version: download, measure, decide, record."""

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import pandas as pd

from cspace.bundle import Bundle, load_verified
from cspace.dataset import open_dataset
from cspace.errors import (
    BundleError,
    ConfigError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
)
from cspace.world import World
from cspace.worlds import robot_digest, simulator_of
from services.evaluator.cluster import on_cluster, spread
from services.evaluator.evaluation import (
    Budget,
    Evaluation,
    Setting,
    Unit,
    UnitResult,
    deciding,
    run_unit,
    table_of,
    units,
)
from services.evaluator.gate import (
    SMALLER_IS_BETTER,
    Bar,
    Champion,
    Comparison,
    Gain,
    Verdict,
    compare,
    decide,
    gated_metrics,
)
from services.evaluator.recalibrate import predicted_reports
from services.evaluator.report import comparison_note, log_evaluation, scenes_text, shown_of
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
from services.registry.entities import ID, SHIPPED, ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import Decision, champions, record_decision
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


@dataclass(frozen=True)
class Rival:
    """A model to be measured on the same scenes, whose world may have another camera.

    ``version`` is its number, None for the shipped model.
    """

    name: str
    world: World
    packed: PackedBundle
    version: int | None = None


class _Rivals:
    """Those of a candidate's robot and kind, no bundle twice, and notes on who is left out."""

    def __init__(self, candidate: Bundle) -> None:
        self.found: list[Rival] = []
        self.notes: list[str] = []
        self._candidate, self._seen = candidate, {candidate.digest}

    def add(self, title: str, bundle: Bundle, number: int | None = None) -> bool:
        """Whether it is of the candidate's robot and kind."""
        if (bundle.spec.kind, bundle.robot) != (self._candidate.spec.kind, self._candidate.robot):
            return False
        if bundle.digest == self._candidate.digest:
            self.notes.append(f"{title}, is this very bundle")
        elif bundle.digest not in self._seen:
            self._seen.add(bundle.digest)
            self.found.append(Rival(title, bundle.spec.world, PackedBundle.pack(bundle), number))
        return True


def find_rivals(
    registry: ModelRegistry, version: ModelVersion, bundle: Bundle, shipped: Path | None, folder: Path
) -> tuple[tuple[Rival, ...], Bar]:
    """The rivals of a candidate to be measured, and the bar that lacks their comparisons.

    They are the present champion, the best before it and, if its folder ``shipped`` is given, the shipped
    model. ``folder`` is for downloads.
    """
    name, rivals, against = version.name, _Rivals(bundle), None
    earlier = _earlier_champions(registry, version, bundle, rivals.notes)

    def fetch(number: int, words: str) -> bool:
        """Whether a version can be measured again."""
        title = f"version {number}, {words}"
        try:
            found = registry.download(registry.version(name, number), folder / str(number))
            return rivals.add(title, load_verified(found), number)
        except RegistryUnavailableError:
            raise
        except (RegistryError, BundleError) as error:
            rivals.notes.append(f"{title}, can not be measured again ({error.what}): recorded metrics count")
            return False

    with suppress(ModelNotFoundError):
        present = registry.by_alias(name, ALIAS_CHAMPION).number
        if present != version.number:
            measured = fetch(present, "the present champion")
            against = present if measured or present in earlier else None
            if measured:
                earlier.pop(present, None)
    for champion in _best_first(earlier.values(), bundle):
        if champion.version != against and fetch(champion.version, "the best before it"):
            del earlier[champion.version]
            break
    if shipped is None:
        rivals.notes.append("not compared with the shipped model, as requested")
    elif not any(rivals.add("the shipped model", Bundle.load(one)) for one in _shipped(shipped)):
        rivals.notes.append("no model of this robot and kind is shipped")
    return tuple(rivals.found), Bar((), tuple(earlier.values()), tuple(rivals.notes), against)


def _earlier_champions(
    registry: ModelRegistry, version: ModelVersion, bundle: Bundle, notes: list[str]
) -> dict[int, Champion]:
    """All champions of the robot by number, but those that were rolled back."""
    earlier = {
        decision.version: Champion(decision.version, decision.metrics)
        for decision in champions(registry, version.name)
        if decision.version != version.number and decision.robot == bundle.robot
    }
    for one in reversed(registry.versions(version.name)):
        left = TAG_ROLLED_BACK in one.tags and ALIAS_CHAMPION not in one.aliases
        if left and earlier.pop(one.number, None) is not None:
            day = one.tags[TAG_ROLLED_BACK][:10]
            notes.append(f"not compared with version {one.number}, which was rolled back on {day}")
    return earlier


def _shipped(folder: Path) -> list[Path]:
    """The shipped models; those of other robots lie beside the first."""
    if not folder.is_dir():
        raise ConfigError(
            "the shipped model is not here",
            expected="its bundle",
            got=str(folder),
            remedy="set CSPACE_PRETRAINED_MODEL, or do without the comparison: --without-shipped",
        )
    beside = (folder.with_name(name) for name in SHIPPED.values())
    return list(dict.fromkeys([folder, *(one for one in beside if one.is_dir())]))


def _best_first(champions: Iterable[Champion], bundle: Bundle) -> list[Champion]:
    """By their recorded metrics, each counted in the world's margins; those that lack some come last."""
    measures = simulator_of(bundle.spec.world).measures
    margins = measures.path_margins if bundle.spec.endpoints else measures.margins

    def rank(champion: Champion) -> tuple[int, float]:
        there = {name: value for name, value in champion.metrics.items() if name in margins}
        signs = {name: -1.0 if name in SMALLER_IS_BETTER else 1.0 for name in there}
        return len(there), sum(signs[name] * value / margins[name] for name, value in there.items())

    return sorted(champions, key=rank, reverse=True)


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
            evaluation = _measure(execute, setting, version, bundle, rivals, progress)
            compared = tuple(
                _with_reports(compare(evaluation, rival.name), bundle, rival, tracking)
                if rival.version == bar.against
                else compare(evaluation, rival.name)
                for rival in rivals
            )
            verdict = decide(evaluation, replace(bar, comparisons=compared))
            figures = log_evaluation(run, evaluation, verdict, bundle_sampler(bundle))
        if request.promote:
            _record(registry, version, evaluation, verdict, progress)
    return Outcome(version, evaluation, verdict, request.promote, run.run_id, figures)


def _with_reports(comparison: Comparison, bundle: Bundle, champion: Rival, tracking: Tracking) -> Comparison:
    """The comparison of a recalibrated version counts the outcomes that it was calibrated by."""
    predicted = predicted_reports(bundle, champion.packed.load(), tracking)
    if predicted is None:
        return comparison
    gain = Gain("log loss of reported plans", *predicted)
    return replace(comparison, gains=(*comparison.gains, gain))


def _measure(
    execute: Execute,
    setting: Setting,
    version: ModelVersion,
    bundle: Bundle,
    rivals: Iterable[Rival],
    progress: Progress,
) -> Evaluation:
    """The version on all scenes, its rivals on those that decide."""

    def run(work: Sequence[Unit], setting: Setting, packed: PackedBundle) -> Iterator[UnitResult]:
        for number, result in enumerate(execute(work, setting, packed), start=1):
            unit = result.unit
            what = f"{unit.task} {unit.family}, {unit.split}"
            progress(f"{number:3d}/{len(work)}  {what}, {unit.count} in {result.seconds:.1f} s")
            yield result

    work = units(setting)
    results = list(run(work, setting, PackedBundle.pack(bundle)))
    tables = [table_of(results, str(version))]
    for rival in rivals:
        progress(f"measuring {rival.name}, on the same scenes")
        # The candidate's scenes, seen by the rival's camera.
        seen = replace(cast("Any", setting.world), sensor=rival.world.sensor)
        theirs = replace(setting, world=seen, budget=replace(setting.budget, narrow_scenarios=0))
        tables.append(table_of(list(run(deciding(work), theirs, rival.packed)), rival.name))
    cpu_s = sum(one.seconds for one in results)
    return Evaluation(setting, str(version), pd.concat(tables, ignore_index=True), cpu_s)


def _record(
    registry: ModelRegistry,
    version: ModelVersion,
    evaluation: Evaluation,
    verdict: Verdict,
    progress: Progress,
) -> None:
    """Append the decision to the version's log, move the alias if it is a promotion, show the figures."""
    metrics, digest = gated_metrics(evaluation), robot_digest(evaluation.setting.world)
    moment_ms = time.time_ns() // 1_000_000
    decided = (verdict.promoted, verdict.reasons, metrics, verdict.bar.against, moment_ms, digest)
    record_decision(registry, Decision(version.name, version.number, *decided))
    try:
        registry.show(version, shown_of(evaluation, comparison_note(evaluation, verdict)))
    except RegistryUnavailableError:
        raise
    except RegistryError as error:
        # The decision stands without figures and note on the version's page.
        progress(f"the figures are not shown with {version}: {error.what}")
