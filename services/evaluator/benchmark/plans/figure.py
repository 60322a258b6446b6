"""Safety against coverage: what collides if only the surest plans are taken."""

from collections.abc import Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.evaluator.benchmark.plans.unchecked import Plans, hits
from services.evaluator.benchmark.telling.curves import STYLE

_MARKS = "osD^v<>P"


def safety_figure(found: Sequence[Plans]) -> Figure:
    """A panel for each source and number of pictures: a curve a model, a mark for every other arm."""
    sources = list(dict.fromkeys(one.source for one in found))
    columns = max(sum(one.source == source for one in found) for source in sources)
    with rc_context(STYLE):
        figure = Figure(
            figsize=(4.2 * columns + 0.6, 3.9 * len(sources) + 0.7), dpi=110, layout="constrained"
        )
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(sources), columns, squeeze=False, sharex=True, sharey=True)
        for row, source in zip(grid, sources, strict=True):
            mine = [one for one in found if one.source == source]
            for axes in row[len(mine) :]:
                axes.set_visible(False)
            for axes, one in zip(row, mine, strict=False):
                _panel(axes, one)
            row[0].set_ylabel("share of the ways that collide")
        for axes in grid[-1]:
            axes.set_xlabel("share of the problems that are answered")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _panel(axes: Any, one: Plans) -> None:
    for model in one.models:
        if (sure := one.sureness(model)) is not None:
            axes.plot(sure.share, sure.collide, label=f"{model}, by min_confidence", linewidth=1.8)
    others = [arm for arm in one.arms if arm not in one.models]
    for number, arm in enumerate(others):
        runs = one.arms[arm]
        ways = [run for run in runs if run.solved]
        share = sum(map(hits, ways)) / len(ways) if ways else float("nan")
        mark, colour = _MARKS[number % len(_MARKS)], f"C{len(one.models) + number}"
        at = len(ways) / len(runs)
        axes.plot([at], [share], mark, color=colour, label=arm, markersize=7, clip_on=False, zorder=3)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    pictures = "one picture" if one.pictures == 1 else f"{one.pictures} pictures"
    axes.set_title(f"{one.source}, {pictures}\n{one.count} problem{'s' * (one.count > 1)}", fontsize=10)
