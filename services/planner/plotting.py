"""Plots of a problem: the arm in its workspace beside its configuration space."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cspace.errors import ConfigError, StorageError
from cspace.planning.paths import spread_points
from cspace.simulator import OWN, Problem
from cspace.space import JointSpace
from cspace.worlds import checker_of, simulator_of
from services.planner.result import PlanResult

INK = "#2b2f36"
MUTED = "#6b7280"
OBSTACLE = "#d3cfc7"
START = "#1f6fb2"
GOAL = "#c0392b"
PATH = "#e08a1e"
LEARNED = "#1a9e8c"
TREE = "#8d97a8"
# From the start to the goal, 72 % of the way to white.
_ALONG = LinearSegmentedColormap.from_list(
    "along", [0.28 * np.array(to_rgb(colour)) + 0.72 for colour in (START, GOAL)]
)
_SAME_RAD = 1e-9


def wrapped_segments(
    space: JointSpace, starts: NDArray[np.float64], ends: NDArray[np.float64], joints: tuple[int, int]
) -> NDArray[np.float64]:
    """Segments in the plane of two joints, with a shifted copy of each one that crosses a seam.

    Starts and ends are (N, d) rad; the result is (M, 2, 2): M lines, two ends, two joints. The axes clip what
    lies outside the joints' ranges.
    """
    plane = list(joints)
    first = space.wrap(starts)[:, plane]
    lines = np.stack([first, first + space.difference(starts, ends)[:, plane]], axis=1)
    # An end on a seam is on it at both sides, however its place was rounded.
    low, high = np.asarray(space.lower)[plane] - _SAME_RAD, np.asarray(space.upper)[plane] + _SAME_RAD
    turns = [(-1, 0, 1) if space.periodic[joint] else (0,) for joint in plane]
    copies = [lines + 2.0 * np.pi * np.array(turn) for turn in product(*turns)]
    seen = [copy[np.all((copy.max(axis=1) >= low) & (copy.min(axis=1) <= high), axis=-1)] for copy in copies]
    return np.concatenate(seen)


CELLS = 320
CELLS_AVERAGED = 110
_HIDDEN_DRAWS = 48
_HALF_PI_TICKS = (r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$")
_SHADE = LinearSegmentedColormap.from_list("collision", ["white", OBSTACLE])


def plot_configurations(
    axes: Any,
    problem: Problem,
    result: PlanResult,
    samples: NDArray[np.float32] | None,
    joints: tuple[int, int],
) -> None:
    """Plots obstacles, tree, samples (n, d), path, start and goal in the plane of two joints."""
    space, plane = problem.space, list(joints)
    extent = [v for joint in joints for v in (space.lower[joint], space.upper[joint])]
    share = collision_share(problem, joints, CELLS if space.dim == 2 else CELLS_AVERAGED)
    axes.imshow(
        share, extent=extent, origin="lower", cmap=_SHADE, vmin=0, vmax=1, interpolation="bilinear", zorder=0
    )
    if result.tree is not None and len(result.tree.edges):
        ends = result.tree.vertices[result.tree.edges]
        _plot_lines(
            axes, wrapped_segments(space, ends[:, 0], ends[:, 1], joints), TREE, 0.9, 1, "search tree"
        )
    if samples is not None and len(samples):
        look: dict[str, Any] = {"color": LEARNED, "linewidths": 0, "alpha": 0.75, "label": "learned samples"}
        axes.scatter(*samples[:, plane].T, s=7, zorder=2, **look)
    if len(result.path) > 1:
        lines = wrapped_segments(space, result.path[:-1], result.path[1:], joints)
        _plot_lines(axes, lines, "white", 4.2, 3)
        _plot_lines(axes, lines, PATH, 2.4, 4, "path")
    for end, name, colour, marker in (
        (problem.start, "start", START, "o"),
        (problem.goal, "goal", GOAL, "D"),
    ):
        look = {"color": colour, "markeredgecolor": "white", "label": name}
        axes.plot(*space.wrap(end)[plane], marker, markersize=8, zorder=5, **look)
    _label(axes, space, joints)


def collision_share(problem: Problem, joints: tuple[int, int], cells: int) -> NDArray[np.float64]:
    """Share of colliding configurations behind each point of a plane, (cells, cells): second joint by rows.

    For more than two joints it is over fixed draws of the joints that the plane does not show.
    """
    space = problem.space
    checker = checker_of(problem.scenario)
    first, second = (
        np.linspace(space.lower[joint], space.upper[joint], 2 * cells + 1)[1::2] for joint in joints
    )
    hidden = space.sample_uniform(np.random.default_rng(0), 1 if space.dim == 2 else _HIDDEN_DRAWS)
    total = np.zeros(cells * cells)
    for draw in hidden:
        grid = np.tile(draw, (cells * cells, 1))
        grid[:, joints[0]] = np.tile(first, cells)
        grid[:, joints[1]] = np.repeat(second, cells)
        total += ~checker.valid_batch(grid)
    return (total / len(hidden)).reshape(cells, cells)


def _plot_lines(
    axes: Any, lines: NDArray[np.float64], colour: str, width: float, order: int, label: str = ""
) -> None:
    look: dict[str, Any] = {"colors": colour, "linewidths": width, "label": label}
    axes.add_collection(LineCollection(list(lines), capstyle="round", zorder=order, **look), autolim=False)


def _label(axes: Any, space: JointSpace, joints: tuple[int, int]) -> None:
    for joint, axis, name in zip(joints, (axes.xaxis, axes.yaxis), "xy", strict=True):
        low, high = space.lower[joint], space.upper[joint]
        axes.set(**{f"{name}lim": (low, high), f"{name}label": rf"$\theta_{{{joint + 1}}}$ (rad)"})
        if space.periodic[joint]:
            axis.set_ticks(np.arange(-2, 3) * np.pi / 2.0, _HALF_PI_TICKS)
    axes.set_aspect("equal")
    axes.set_title("configuration space" if space.dim == 2 else f"joints {joints[0] + 1} and {joints[1] + 1}")


POSES = 16
_TRACE_POINTS = 400


def plot_workspace(axes: Any, problem: Problem, path: NDArray[np.float64]) -> None:
    """Plots a problem's workspace and, unless it is empty, the sweep of a path (k, d) rad."""
    simulator = simulator_of(problem.scenario.world)
    simulator.draw_scene(axes, problem.scenario, OBSTACLE)
    if len(path) > 1:
        shares = np.linspace(0.0, 1.0, POSES + 2)[1:-1]
        poses = spread_points(path, POSES + 2, problem.space)[1:-1]
        for share, configuration in zip(shares, poses, strict=True):
            simulator.draw_robot(axes, configuration, to_hex(_ALONG(share)), 2)
        tips = simulator.drawn_joints_m(spread_points(path, _TRACE_POINTS, problem.space))[:, -1]
        axes.plot(*tips.T, color=PATH, linewidth=1.8, zorder=3)
    for configuration, colour in ((problem.start, START), (problem.goal, GOAL)):
        simulator.draw_robot(axes, configuration, colour, 4)
        joints = simulator.drawn_joints_m(configuration)[0][1:-1]
        axes.plot(*joints.T, "o", markersize=3, color="white", zorder=5)
    axes.plot(0.0, 0.0, "o", markersize=7, color=INK, zorder=6)
    axes.set_title("workspace")


FORMATS = (".png", ".pdf", ".svg")
_STYLE: dict[Any, Any] = {
    "font.size": 10, "axes.titlesize": 10, "axes.titlecolor": MUTED, "axes.labelcolor": INK,
    "axes.edgecolor": "#b8bcc4", "axes.linewidth": 0.8, "text.color": INK, "xtick.color": MUTED,
    "ytick.color": MUTED,
}  # fmt: skip


def plot_plan(
    problem: Problem, result: PlanResult, samples: NDArray[np.float32] | None = None, title: str | None = None
) -> Figure:
    """The workspace and up to two planes of the configuration space; the default title is the outcome."""
    dim = problem.space.dim
    planes = [(joint, joint + 1) for joint in range(min(dim - 1, 2))]
    with rc_context(_STYLE):
        figure = Figure(figsize=(4.9 * (1 + len(planes)), 5.6), dpi=130, layout="constrained")
        panels = figure.subplots(1, 1 + len(planes), squeeze=False)[0]
        plot_workspace(panels[0], problem, result.path)
        for axes, joints in zip(panels[1:], planes, strict=True):
            plot_configurations(axes, problem, result, samples, joints)
        figure.suptitle(outcome_title(problem, result) if title is None else title, fontsize=12)
        drawn = [axes.get_legend_handles_labels() for axes in panels]
        handles = {name: handle for found in drawn for handle, name in zip(*found, strict=True)}
        handles["obstacles" if dim != 2 else "obstacles, collision region"] = Patch(facecolor=OBSTACLE)
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside lower center",
            ncols=len(handles),
            frameon=False,
        )
    return figure


def outcome_title(problem: Problem, result: PlanResult) -> str:
    """A problem and its outcome in one line."""
    name = "own problem" if problem.family == OWN else f"{problem.family} problem, seed {problem.seed}"
    if not result.solved:
        return f"{name}: not solved, {result.reason} ({result.iterations} iterations)"
    return f"{name}: solved in {result.iterations} iterations, path of {result.length_rad:.2f} rad"


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file name's suffix."""
    try:
        figure.savefig(path)
    except OSError as error:
        what, remedy = f"the figure {path} can not be written", "name another file"
        raise StorageError(what, got=str(error), remedy=remedy) from error


def check_figure_path(path: Path) -> None:
    """Raises ConfigError where the suffix names no format or the folder does not exist."""
    if path.suffix not in FORMATS:
        raise ConfigError("the figure's format is unknown", expected=" or ".join(FORMATS), got=path.name)
    if not path.absolute().parent.is_dir():
        raise ConfigError("the figure's folder does not exist", got=str(path.absolute().parent))
