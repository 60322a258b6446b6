"""A benchmark's units in the order of the work, in this process."""

from collections.abc import Iterator, Sequence

from services.evaluator.benchmark.job import Models, run_unit
from services.evaluator.benchmark.variants import Setting, Unit


def run_here(work: Sequence[Unit], setting: Setting, models: Models) -> Iterator[list[dict]]:
    for unit in work:
        yield run_unit(unit, (setting, models))
