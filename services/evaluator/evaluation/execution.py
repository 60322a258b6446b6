"""Units of work, one after the other in this process. The job spreads the same units over a cluster."""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

from services.evaluator.evaluation.budget import Unit
from services.evaluator.evaluation.units import Setting, UnitResult, run_unit
from services.evaluator.measures.samplers import PackedBundle, bundle_sampler
from services.planner.sources.samples import SampleSource

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
