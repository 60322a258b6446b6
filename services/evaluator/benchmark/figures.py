"""The figures of the benchmark: success, and safety of plans."""

from collections.abc import Iterator
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from cspace.simulator import Taken as Unseen
from services.evaluator.benchmark.estimates import Paired, confidence_curve
from services.evaluator.benchmark.report import Results
from services.evaluator.benchmark.variants import Group
from services.planner.plotting import INK

# Told apart by most eyes, and in print by their lightness (after Okabe and Ito).
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_STYLE: dict[Any, Any] = {"font.size": 9, "axes.grid": True, "grid.color": "#e6e8ec", "axes.axisbelow": True}
_BESIDE: dict[str, Any] = {
    "loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "frameon": False, "fontsize": 8,
}  # fmt: skip
_LINES = ("-", "--", ":", "-.")


def figures(results: Results) -> Iterator[tuple[str, Figure]]:
    """Every figure that the runs have content for, with its name."""
    with rc_context(_STYLE):
        for name, plot, groups in (
            ("success", _success, {Group.UNIFORM, Group.LEARNED}),
            ("safety", _safety, {Group.PLANS}),
        ):
            found = {}
            for group, runs in results.groups.items():
                own = runs[runs["group"].isin(groups)]
                if len(own) and own["solved"].any():
                    found[group] = Paired(own)
            if found:
                yield name, plot(found, results)


def _panels(rows: int, columns: int, width: float = 4.2) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width * columns + 2.0, 3.4 * rows), dpi=110, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def _looks(paired: Paired, results: Results) -> dict[str, dict[str, Any]]:
    """Colour and line of each variant of a panel; uniform ones are black."""
    shown = [one for one in results.variants if one.name in paired]
    uniform, learned = cycle(_LINES), cycle([(c, line) for line in _LINES for c in _COLOURS])
    looks = {}
    for one in shown:
        colour, line = (INK, next(uniform)) if one.sampler is None else next(learned)
        looks[one.name] = {"color": colour, "linestyle": line, "label": one.name}
    return looks


def _success(found: dict[str, Paired], results: Results) -> Figure:
    """Share solved against iterations, edge checks and whole time, a row for each family."""
    shown = (("iterations", 1.0, "iterations"), ("edge_checks", 1.0, "edge checks"), ("total_s", 1e3, "ms"))
    figure, grid = _panels(len(found), 3)
    for row, (family, paired) in zip(grid, found.items(), strict=True):
        for axes, (column, scale, label) in zip(row, shown, strict=True):
            for name, look in _looks(paired, results).items():
                solved = paired.solved(name)
                taken = np.sort(scale * paired.values(name, column)[solved])
                shares = np.arange(1, len(taken) + 1) / solved.size
                axes.step(np.maximum(taken, 1e-3), shares, where="post", **look)
            axes.set(xscale="log", xlabel=label, ylim=(-0.02, 1.02))
        row[0].set_ylabel(f"{family}\nshare solved")
        row[-1].legend(**_BESIDE)
    return figure


def _safety(found: dict[str, Paired], results: Results) -> Figure:
    """Share of colliding paths against answered problems: a curve for each model, a mark for each rule."""
    sources = {
        name: one for name, one in found.items() if name.partition(",")[0] in set(results.runs["source"])
    }
    figure, grid = _panels(1, len(sources))
    for axes, (group, paired) in zip(grid[0], sources.items(), strict=True):
        for one in (one for one in results.variants if one.name in paired):
            own = paired.of(one.name)
            if one.sampler is not None:
                curve = confidence_curve(own)
                axes.plot(curve["answered"], curve["collide"], label=one.name)
            elif one.unseen is not Unseen.KNOWN and own["solved"].any():
                collide = (own["clearance_m"][own["solved"]] <= 0.0).mean()
                axes.plot(own["solved"].mean(), collide, "o", label=one.name)
        axes.set(
            title=f"{group} picture(s)\n{paired.problems} problems", xlabel="share of the problems answered"
        )
        axes.set(xlim=(0.0, 1.02), ylim=(0.0, None))
    grid[0][0].set_ylabel("share of the paths that collide")
    grid[0][-1].legend(**_BESIDE)
    return figure
