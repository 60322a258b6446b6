"""One figure of a planning problem: the arm in its workspace beside its configuration space."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cspace.errors import ConfigError, StorageError
from cspace.simulator import OWN, Problem
from services.planner.drawing import palette
from services.planner.drawing.configuration_panel import draw_configurations
from services.planner.drawing.workspace_panel import draw_workspace
from services.planner.plan_result import PlanResult

FORMATS = ("png", "pdf", "svg")
_STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.titlecolor": palette.MUTED,
    "axes.labelcolor": palette.INK,
    "axes.edgecolor": "#b8bcc4",
    "axes.linewidth": 0.8,
    "text.color": palette.INK,
    "xtick.color": palette.MUTED,
    "ytick.color": palette.MUTED,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
}


def draw_plan(
    problem: Problem,
    result: PlanResult,
    samples: NDArray[np.float32] | None = None,
    title: str | None = None,
) -> Figure:
    """The workspace and up to two planes of the configuration space, side by side.

    Args:
        problem: that was solved.
        result: of the planner; its tree is drawn where it was kept.
        samples: (n, d) learned samples in rad, or None.
        title: over the panels; None for the outcome in words.
    """
    dim = problem.space.dim
    planes = [(joint, joint + 1) for joint in range(min(dim - 1, 2))]
    with rc_context(_STYLE):
        figure = Figure(figsize=(4.9 * (1 + len(planes)), 5.6), dpi=130, layout="constrained")
        panels = figure.subplots(1, 1 + len(planes), squeeze=False)[0]
        draw_workspace(panels[0], problem, result.path)
        for axes, joints in zip(panels[1:], planes, strict=True):
            draw_configurations(axes, problem, result, samples, joints)
        figure.suptitle(outcome_title(problem, result) if title is None else title, fontsize=12)
        handles = _legend_handles(dim, result, samples)
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def outcome_title(problem: Problem, result: PlanResult) -> str:
    """A problem and its outcome in one line."""
    name = "own problem" if problem.family == OWN else f"{problem.family} problem, seed {problem.seed}"
    if not result.solved:
        return f"{name}: not solved, {result.reason} ({result.iterations} iterations)"
    return f"{name}: solved in {result.iterations} iterations, path of {result.length_rad:.2f} rad"


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the format is the file name's suffix.

    Raises:
        ConfigError: the suffix names no format.
        StorageError: the file can not be written.
    """
    check_figure_path(path)
    try:
        figure.savefig(path)
    except OSError as error:
        raise StorageError(
            f"the figure {path} can not be written", got=str(error), remedy="name another file"
        ) from error


def check_figure_path(path: Path) -> None:
    """Whether a figure could be written there, before it costs anything to find out.

    Raises:
        ConfigError: the suffix names no format, or the folder does not exist.
    """
    if path.suffix.lower().removeprefix(".") not in FORMATS:
        raise ConfigError(
            "the figure's format is unknown",
            expected=" or ".join(f".{suffix}" for suffix in FORMATS),
            got=path.name,
        )
    if not path.absolute().parent.is_dir():
        raise ConfigError("the figure's folder does not exist", got=str(path.absolute().parent))


def _legend_handles(dim: int, result: PlanResult, samples: NDArray[np.float32] | None) -> list[Any]:
    region = "obstacles, collision region" if dim == 2 else "obstacles, share in collision"
    handles: list[Any] = [
        _dot("start", palette.START, "o"),
        _dot("goal", palette.GOAL, "D"),
        Patch(facecolor=palette.OBSTACLE, label=region if dim > 1 else "obstacles"),
    ]
    if samples is not None and len(samples):
        handles.append(_dot("learned samples", palette.LEARNED, ".", 6))
    if result.tree is not None:
        handles.append(Line2D([], [], color=palette.TREE, linewidth=1.0, label="search tree"))
    if len(result.path) > 1:
        handles.append(Line2D([], [], color=palette.PATH, linewidth=2.4, label="path"))
    return handles


def _dot(label: str, colour: str, marker: str, size: float = 7) -> Line2D:
    return Line2D([], [], linestyle="", marker=marker, markersize=size, color=colour, label=label)
