"""A benchmark's units in the order of the work, in this process."""

from collections.abc import Iterator, Sequence

from services.evaluator.benchmark.arms import Setting, Unit
from services.evaluator.benchmark.execution import run_unit
from services.evaluator.benchmark.sources import SourceSpec


def run_here(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[dict]]:
    for unit in work:
        yield run_unit(unit, (setting, tuple(specs)))
