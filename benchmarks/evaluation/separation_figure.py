"""Draws what separation.py has measured.

python -m benchmarks.evaluation.separation_figure separation.json docs/images/gsc_separation.png
python -m benchmarks.evaluation.separation_figure doors.json docs/images/gsc_doors.png --doors
"""

import json
import sys
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from benchmarks.command import arguments

INK, MUTED = "#222222", "#6f6f6f"
FLOOR, CHANGED, FARTHER, CONTROL = "#8f9aa6", "#e08b3e", "#b8402a", "#4f7cac"
DOORS = (
    ("whole, whole", "floor: a door each", FLOOR),
    ("divided, divided", "floor: divided each", CONTROL),
    ("whole, divided", "a door against divided", FARTHER),
)
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


def draw_doors(content) -> Figure:
    """Both scores between a divided room and one with a door, by the width of the door."""
    figure = Figure(figsize=(9.0, 3.6), dpi=100, layout="constrained")
    found = {(one["case"], one["pair"], one["score"]): one for one in content["summary"]}
    cases = sorted({case for case, *_ in found if case.startswith("door")}, key=width_of)
    for axes, score, name in zip(figure.subplots(1, 2), ("gs", "gsc"), ("GS", "GS-C"), strict=True):
        for number, (pair, label, colour) in enumerate(DOORS):
            places = [at + 0.12 * (number - 1) for at in range(len(cases))]
            rows = [found[case, pair, score] for case in cases]
            means = [1e4 * row["estimate"] for row in rows]
            axes.plot(places, means, "D", ms=5, c=colour, mec="white", mew=0.6, label=label)
            axes.vlines(places, *([1e4 * row[end] for row in rows] for end in ("low", "high")), colour, lw=3)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xticks(range(len(cases)), [f"{width_of(case):g}" for case in cases])
        axes.set_xlabel("width of the door, rad (the wall is 5.6 rad long)")
        axes.set_ylabel(f"{name} x 1e4")
        axes.set_title(name, loc="left", fontsize=11)
        axes.grid(visible=True, axis="y", color="#e6e6e6")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].legend(frameon=False, fontsize=8.5)
    return figure


def width_of(case: str) -> float:
    return float(case.split()[1])


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("measured", type=Path)
    parser.add_argument("image", type=Path)
    parser.add_argument("--doors", action="store_true", help="the cases of the door, by its width")
    options = parser.parse_args()
    picture = draw_doors if options.doors else draw
    picture(json.loads(options.measured.read_text())).savefig(options.image)
    return 0


if __name__ == "__main__":
    sys.exit(main())
