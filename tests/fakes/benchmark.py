"""A benchmark's units in the order of the work, in this process."""

from collections.abc import Iterator, Sequence

from services.evaluator.benchmark.arms import Setting, Unit
from services.evaluator.benchmark.measure import measure
from services.evaluator.benchmark.sources import SourceSpec, opened
from services.evaluator.benchmark.store import Run


def run_here(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Run]]:
    with opened(specs, setting.world) as sources:
        for unit in work:
            yield measure(unit, setting, {spec.name: spec for spec in specs}, sources)
