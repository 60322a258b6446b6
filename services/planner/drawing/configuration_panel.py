"""The configuration space in the plane of two joints: collision region, samples, tree and path."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from cspace.simulator import Problem
from cspace.space import JointSpace
from cspace.worlds import checker_of
from services.planner.drawing import palette
from services.planner.drawing.wrapping import wrapped_segments
from services.planner.plan_result import PlanResult

CELLS = 320
CELLS_AVERAGED = 110
_HIDDEN_DRAWS = 48
_HALF_PI_TICKS = (r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$")
_SHADE = LinearSegmentedColormap.from_list("collision", ["white", palette.OBSTACLE])


def draw_configurations(
    axes: Any,
    problem: Problem,
    result: PlanResult,
    samples: NDArray[np.float32] | None,
    joints: tuple[int, int],
) -> None:
    """Draw one plane of the configuration space.

    Args:
        axes: of matplotlib.
        problem: scenario, start and goal.
        result: path and, where it was kept, tree.
        samples: (n, d) learned samples in rad, or None.
        joints: which two make the plane.
    """
    space, plane = problem.space, list(joints)
    extent = [v for joint in joints for v in (space.lower[joint], space.upper[joint])]
    share = collision_share(problem, joints, CELLS if space.dim == 2 else CELLS_AVERAGED)
    axes.imshow(
        share, extent=extent, origin="lower", cmap=_SHADE, vmin=0, vmax=1, interpolation="bilinear", zorder=0
    )
    if result.tree is not None and len(result.tree.edges):
        ends = result.tree.vertices[result.tree.edges]
        _draw_lines(axes, wrapped_segments(space, ends[:, 0], ends[:, 1], joints), palette.TREE, 0.9, 1)
    if samples is not None and len(samples):
        axes.scatter(*samples[:, plane].T, s=7, color=palette.LEARNED, linewidths=0, alpha=0.75, zorder=2)
    if len(result.path) > 1:
        lines = wrapped_segments(space, result.path[:-1], result.path[1:], joints)
        _draw_lines(axes, lines, "white", 4.2, 3)
        _draw_lines(axes, lines, palette.PATH, 2.4, 4)
    for configuration, colour, marker in (
        (problem.start, palette.START, "o"),
        (problem.goal, palette.GOAL, "D"),
    ):
        at = space.wrap(configuration)[plane]
        axes.plot(*at, marker, markersize=8, color=colour, markeredgecolor="white", zorder=5)
    _label(axes, space, joints)


def collision_share(problem: Problem, joints: tuple[int, int], cells: int) -> NDArray[np.float64]:
    """Share of colliding configurations behind each point of a plane, (cells, cells): second joint by rows.

    0 or 1 for a robot of two joints; for more, over one fixed set of draws of the joints that the plane does
    not show.
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


def _draw_lines(axes: Any, lines: NDArray[np.float64], colour: str, width: float, order: int) -> None:
    axes.add_collection(
        LineCollection(list(lines), colors=colour, linewidths=width, capstyle="round", zorder=order),
        autolim=False,
    )


def _label(axes: Any, space: JointSpace, joints: tuple[int, int]) -> None:
    for joint, axis, name in zip(joints, (axes.xaxis, axes.yaxis), "xy", strict=True):
        low, high = space.lower[joint], space.upper[joint]
        axes.set(**{f"{name}lim": (low, high), f"{name}label": rf"$\theta_{{{joint + 1}}}$ (rad)"})
        if space.periodic[joint]:
            axis.set_ticks(np.arange(-2, 3) * np.pi / 2.0, _HALF_PI_TICKS)
    axes.set_aspect("equal")
    axes.set_title("configuration space" if space.dim == 2 else f"joints {joints[0] + 1} and {joints[1] + 1}")
