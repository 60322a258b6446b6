"""One picture of what grows how, from the results of the other benchmarks of this folder.

python -m benchmarks.scale.figure --growth build/growth --placement build/placement --out build/scaling.png
"""

import statistics
import sys
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.command import arguments
from benchmarks.lines import read

STAGES = {"data_s": "data", "cluster_s": "clustering", "trials_s": "local trials"}
TITLES = {"scenarios": "scenarios", "samples": "samples a scenario", "clusters": "clusters (trials)"}


def growth(axes: Axes, rows: list[dict], key: str) -> None:
    """Seconds of each stage over one number, the others in the middle."""
    middle = {name: statistics.median_low(sorted({row[name] for row in rows})) for name in TITLES}
    # Of clusters the middle is the two that presets take.
    middle["clusters"] = 2
    mine = [row for row in rows if all(row[name] == middle[name] for name in TITLES if name != key)]
    values = sorted({row[key] for row in mine})
    for stage, label in STAGES.items():
        found = [[row[stage] for row in mine if row[key] == value] for value in values]
        draw(axes, values, found, label)
    axes.set(xlabel=TITLES[key], ylabel="seconds", xscale="log")
    axes.set_ylim(bottom=0.0)
    axes.set_xticks(values, [str(value) for value in values], minor=False)
    axes.set_xticks([], minor=True)


def placement(axes: Axes, rows: list[dict]) -> None:
    """The driver's processor time over the nodes, by reports a trial."""
    for each in sorted({row["reports"] // row["nodes"] for row in rows}):
        mine = [row for row in rows if row["reports"] // row["nodes"] == each]
        nodes = sorted({row["nodes"] for row in mine})
        found = [[row["driver_cpu_s"] for row in mine if row["nodes"] == count] for count in nodes]
        draw(axes, nodes, found, f"{each} reports a trial")
    axes.set(xlabel="nodes, a trial each", ylabel="driver's processor time, s")


def draw(axes: Axes, values: list[int], found: list[list[float]], label: str) -> None:
    middle = [statistics.median(some) for some in found]
    low = [mid - min(some) for mid, some in zip(middle, found, strict=True)]
    high = [max(some) - mid for mid, some in zip(middle, found, strict=True)]
    axes.errorbar(values, middle, yerr=[low, high], marker="o", capsize=3, label=label)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--growth", type=Path, required=True)
    parser.add_argument("--placement", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.6), layout="constrained")
    rows = read(options.growth / "results.jsonl")
    for where, key in zip(axes, TITLES, strict=False):
        growth(where, rows, key)
    placement(axes[3], read(options.placement / "results.jsonl"))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=110)
    return 0


if __name__ == "__main__":
    sys.exit(main())
