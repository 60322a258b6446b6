"""From a dragged disc to its samples in the workbench, in headless Chromium.

    python -m benchmarks.serving.interaction [--drags 20]

A server of its own on the shipped model, with the truth. Discs are dragged about the plane; the page measures
from each movement that it sends to the picture with its samples. Median, quartiles and 95th percentile, ms,
without the first drag. Wants Chromium and a machine that does nothing else.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from playwright.sync_api import Page

from benchmarks.machine import machine
from tests.browser.chromium import browser_page
from tests.browser.workbench import (
    SCENE,
    bench_server,
    discs_in_address,
    drag,
    hash_of,
    open_bench,
    wait_for_disc,
)

MOVED, STEPS = 2, 20
# Corners of the lower half of the plane, m.
ENDS = ((1.5, -1.8), (2.5, -2.5), (0.5, -3.2))


def main() -> int:
    """Parse, drag, print."""
    options = parser().parse_args()
    print(machine())
    with (
        tempfile.TemporaryDirectory() as folder,
        bench_server(Path(folder)) as address,
        browser_page() as page,
    ):
        open_bench(page, address, hash_of(SCENE))
        times = np.concatenate(list(_drags(page, options.drags + 1))[1:])
        page.goto("about:blank")
    low, middle, high, late = np.quantile(times, (0.25, 0.5, 0.75, 0.95))
    print(f"{len(times)} movements: {middle:.0f} ms ({low:.0f} to {high:.0f}), 95th percentile {late:.0f} ms")
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    found = argparse.ArgumentParser(
        prog="python -m benchmarks.serving.interaction", description="How soon samples follow a dragged disc."
    )
    found.add_argument("--drags", type=int, default=20, help="of the disc, each of twenty movements")
    return found


def _drags(page: Page, count: int) -> Iterator[np.ndarray]:
    for turn in range(count):
        end = ENDS[turn % len(ENDS)]
        page.evaluate("() => performance.clearMeasures()")
        x, y, _ = discs_in_address(page)[MOVED]
        drag(page, (x, y), end, steps=STEPS)
        wait_for_disc(page, MOVED, *end)
        told = "() => performance.getEntriesByName('interaction-to-samples').map((one) => one.duration)"
        yield np.array(page.evaluate(told))


if __name__ == "__main__":
    sys.exit(main())
