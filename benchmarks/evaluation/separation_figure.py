"""Draws what separation.py has measured.

python benchmarks/evaluation/separation_figure.py separation.json docs/images/gsc_separation.png
"""

import argparse
import json
import sys
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

INK, MUTED = "#222222", "#6f6f6f"
FLOOR, CHANGED, FARTHER, CONTROL = "#8f9aa6", "#e08b3e", "#b8402a", "#4f7cac"
MEAN = "mean of scenarios"
SAMPLES = (("real", FLOOR), ("noise", CHANGED), ("uniform", FARTHER))
DIVISIONS = (
    ("whole, whole", FLOOR),
    ("divided, divided", FLOOR),
    ("whole, rim", CONTROL),
    ("whole, divided", FARTHER),
)


def line(axes, place, summary, singles, colour):
    """All single scores as dots, the mean with its interval on top."""
    axes.plot([x * 1e4 for x in singles], [place] * len(singles), "o", ms=4.5, mew=0, alpha=0.3, c=colour)
    low, mean, high = (summary[key] * 1e4 for key in ("low", "estimate", "high"))
    axes.plot([low, high], [place, place], lw=3.5, c=colour, solid_capstyle="butt")
    axes.plot(mean, place, "D", ms=6, c=colour, mec="white", mew=0.8)


def singles_of(content, case, pair, score):
    """Single scores of a case; of all scenarios together the mean over them, one for each repeat."""
    if case != MEAN:
        return [row["scores"][pair][score] for row in content["rows"] if row["case"] == case]
    by_repeat = {}
    for row in content["rows"]:
        if row["case"].startswith("scenario"):
            by_repeat.setdefault(row["repeat"], []).append(row["scores"][pair][score])
    return [sum(values) / len(values) for values in by_repeat.values()]


def lines(axes, content, entries, score):
    """One line an entry: case, pair, label and colour."""
    for place, (case, pair, _, colour) in enumerate(entries):
        summary = next(
            one
            for one in content["summary"]
            if (one["case"], one["pair"], one["score"]) == (case, pair, score)
        )
        singles = singles_of(content, case, pair, score)
        line(axes, place, summary, singles, colour)
    axes.set_yticks(range(len(entries)), [label for _, _, label, _ in entries], color=INK)
    axes.set_ylim(len(entries) - 0.4, -0.6)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(0.15, 100.0) if score == "gsc" else axes.set_xlim(4.0, 500.0)
    axes.grid(visible=True, axis="x", color="#e6e6e6")
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(left=False)


def draw(content) -> Figure:
    figure = Figure(figsize=(11.0, 5.6), dpi=100, layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.05))
    scenarios = sorted({row["case"] for row in content["rows"] if row["case"].startswith("scenario")})
    entries = [
        (case, pair, f"{'all' if case == MEAN else case.split(',')[0]}: {pair}", colour)
        for case in (*scenarios, MEAN)
        for pair, colour in SAMPLES
    ]
    axes = left.subplots()
    lines(axes, content, entries, "gsc")
    for place in range(len(SAMPLES), len(entries), len(SAMPLES)):
        axes.axhline(place - 0.5, color="#c8c8c8", lw=0.8)
    axes.set_title("GS-C: real samples against real, noisy, uniform ones", loc="left", fontsize=11)
    axes.set_xlabel("GS-C x 1e4")
    room = [("room", pair, pair, colour) for pair, colour in DIVISIONS]
    for axes, score, name in zip(right.subplots(2, 1), ("gs", "gsc"), ("GS", "GS-C"), strict=True):
        lines(axes, content, room, score)
        axes.set_title(f"{name}: a room, whole or divided by a wall", loc="left", fontsize=11)
        axes.set_xlabel(f"{name} x 1e4")
    setting = content["setting"]
    figure.supxlabel(
        f"Diamond and bar: mean and 95 % interval over {setting['done']} repeats; dots: single scores of "
        f"{setting['samples']} points a cloud, {setting['draws']} draws of landmarks.\n"
        "Grey: noise floor. Rim: as little free space as with the wall, not divided.",
        fontsize=8.5,
        color=MUTED,
    )
    return figure


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("measured", type=Path)
    parser.add_argument("image", type=Path)
    options = parser.parse_args()
    draw(json.loads(options.measured.read_text())).savefig(options.image)
    return 0


if __name__ == "__main__":
    sys.exit(main())
