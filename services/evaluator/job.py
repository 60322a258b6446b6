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
    BUDGETS,
    MAX_SEED,
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


@dataclass(frozen=True)
class Rival:
    """A model to be measured on the same scenes, whose world may have another camera.

    ``version`` is its number, None for the shipped model.
    """

    name: str
    world: World
    packed: PackedBundle
    version: int | None = None


def find_rivals(
    registry: ModelRegistry, version: ModelVersion, bundle: Bundle, shipped: Path | None, folder: Path
) -> tuple[tuple[Rival, ...], Bar]:
    """The rivals of a candidate's robot and kind to be measured, and the bar that lacks their comparisons.

    ``folder`` is for downloads; without ``shipped``, the folder of the shipped model, that one is left out.
    """
    found, name = _Found(bundle, registry, folder), version.name
    earlier = {
        decision.version: Champion(decision.version, decision.metrics)
        for decision in champions(registry, name)
        if decision.version != version.number and decision.robot == robot_digest(bundle.spec.world)
    }
    for one in reversed(registry.versions(name)):
        is_left = TAG_ROLLED_BACK in one.tags and ALIAS_CHAMPION not in one.aliases
        if is_left and earlier.pop(one.number, None) is not None:
            day = one.tags[TAG_ROLLED_BACK][:10]
            found.notes.append(f"not compared with version {one.number}, which was rolled back on {day}")
    against = None
    with suppress(ModelNotFoundError):
        present = registry.by_alias(name, ALIAS_CHAMPION)
        if present.number != version.number:
            measured = found.fetch(name, present.number, "the present champion")
            against = present.number if measured or present.number in earlier else None
            if measured:
                earlier.pop(present.number, None)
    for champion in _best_first(earlier.values(), bundle):
        if champion.version != against and found.fetch(name, champion.version, "the best before it"):
            del earlier[champion.version]
            break
    found.add_shipped(shipped)
    return tuple(found.rivals), Bar((), tuple(earlier.values()), tuple(found.notes), against)


def _best_first(champions: Iterable[Champion], bundle: Bundle) -> list[Champion]:
    """By their recorded metrics, each counted in the world's margins; those that lack some come last."""
    measures = simulator_of(bundle.spec.world).measures
    margins = measures.path_margins if bundle.spec.endpoints else measures.margins

    def rank(champion: Champion) -> tuple[int, float]:
        there = {name: value for name, value in champion.metrics.items() if name in margins}
        signs = {name: -1.0 if name in SMALLER_IS_BETTER else 1.0 for name in there}
        return len(there), sum(signs[name] * value / margins[name] for name, value in there.items())

    return sorted(champions, key=rank, reverse=True)


class _Found:
    """Rivals of a candidate, no bundle twice."""

    def __init__(self, candidate: Bundle, registry: ModelRegistry, folder: Path) -> None:
        self.rivals: list[Rival] = []
        self.notes: list[str] = []
        self._candidate, self._registry, self._folder = candidate, registry, folder
        self._seen = {candidate.digest}

    def fetch(self, name: str, number: int, words: str) -> bool:
        """Whether a version is a rival now, or has the bundle of the candidate or of another rival."""
        try:
            version = self._registry.version(name, number)
            bundle = load_verified(self._registry.download(version, self._folder / str(number)))
        except RegistryUnavailableError:
            raise
        except (RegistryError, BundleError) as error:
            why = f"can not be measured again ({error.what}): recorded metrics count"
            self.notes.append(f"version {number}, {words}, {why}")
            return False
        return self._add(f"version {number}, {words}", bundle, number)

    def add_shipped(self, folder: Path | None) -> None:
        """The shipped model where it is of this robot and kind."""
        if folder is None:
            self.notes.append("not compared with the shipped model, as requested")
            return
        if not folder.is_dir():
            raise ConfigError(
                "the shipped model is not here",
                expected="its bundle",
                got=str(folder),
                remedy="set CSPACE_PRETRAINED_MODEL, or do without the comparison: --without-shipped",
            )
        # Those of other robots lie beside it.
        beside = (folder.with_name(name) for name in SHIPPED.values())
        folders = dict.fromkeys([folder, *(one for one in beside if one.is_dir())])
        if not any(self._add("the shipped model", Bundle.load(one)) for one in folders):
            self.notes.append("no model of this robot and kind is shipped")

    def _add(self, name: str, bundle: Bundle, number: int | None = None) -> bool:
        spec, ours = bundle.spec, self._candidate.spec
        if spec.kind != ours.kind or robot_digest(spec.world) != robot_digest(ours.world):
            return False
        if bundle.digest == self._candidate.digest:
            self.notes.append(f"{name}, is this very bundle")
        elif bundle.digest not in self._seen:
            self._seen.add(bundle.digest)
            self.rivals.append(Rival(name, spec.world, PackedBundle.pack(bundle), number))
        return True


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
