"""Look closely at a view file: what is wrong with its pictures, cameras and state, and what to do.

``python -m services.doctor view.bin``; with ``--bundle`` also how unlike a model's training the view is.

Exit codes: 0 nothing was found, 1 something failed, 2 wrong usage or a file that cannot be read, 3 something
was found.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from cspace.bundle import Bundle
from cspace.errors import ConfigError, CspaceError, InputError, ScenarioError
from cspace.files import read_bounded
from cspace.world import Diagnosis
from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.poses import pose_of
from cspace.worlds.spatial.simulator import draw_arm
from cspace.worlds.spatial.view import DepthView, State
from cspace.worlds.spatial.visibility import arm_depth_m, reduced
from cspace.worlds.spatial.world import SpatialWorld, described
from services.commands import report_error

FOUND = 3
_MAX_BYTES = 64 * 2**20


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        if options.picture is not None and not options.picture.absolute().parent.is_dir():
            raise ConfigError("the picture's folder does not exist", got=str(options.picture))
        world, view, found = _diagnosis(options)
        if options.picture is not None:
            draw(world, view, found, options.picture)
    except CspaceError as error:
        return report_error(error, ConfigError, InputError, ScenarioError)
    sys.stdout.write(f"{json.dumps(asdict(found)) if options.json else lines_of(found)}\n")
    return FOUND if found.findings else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.doctor",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("view", type=Path, help="a view file, as cspace.view_file.pack_view writes it")
    parser.add_argument(
        "--robot", metavar="NAME|FILE", default="panda", help="the arm: panda, ur5, or a file"
    )
    parser.add_argument("--bundle", type=Path, metavar="FOLDER", help="a model, whose arm it is then")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw depths, arm, points and verdicts")
    return parser


def _diagnosis(options: argparse.Namespace) -> tuple[SpatialWorld, DepthView, Diagnosis]:
    bundle = None if options.bundle is None else Bundle.load(options.bundle)
    world = described(argparse.Namespace(arm=options.robot)) if bundle is None else bundle.spec.world
    if not isinstance(world, SpatialWorld):
        raise ConfigError(
            "the model sees no depths",
            expected="a bundle of an arm in space",
            got=str(bundle and bundle.spec.world.kind),
        )
    view = world.view(read_bounded(options.view, _MAX_BYTES, ConfigError))
    found = world.diagnosed(view)
    if bundle is not None:
        found = found.with_novelty(bundle.prepare(world.observed(view)).novelty)
    return world, view, found


def lines_of(found: Diagnosis) -> str:
    """Verdicts, suggested poses and notes for people."""
    lines = []
    for one in found.findings:
        where = f" (picture {', '.join(map(str, one.pictures))})" if one.pictures else ""
        lines += [f"{one.code}{where}: {one.seen}", f"    so {one.effect}", f"    do: {one.remedy}"]
    for pose in found.poses:
        lines.append(
            f"picture {pose.picture}: a pose {100 * pose.offset_m:.1f} cm and {pose.turn_deg:.1f} degrees "
            "from the given one fits:"
        )
        lines.append(f"    {json.dumps([[round(value, 5) for value in row] for row in pose.pose])}")
    lines += [f"note: {note}" for note in found.notes]
    return "\n".join(lines if found.findings else ["nothing wrong was found", *lines])


def draw(world: SpatialWorld, view: DepthView, found: Diagnosis, path: Path) -> None:
    """Write a picture: of each camera depths, the arm as rendered, the points from the side, the verdicts."""
    # A second that errors need not wait.
    from matplotlib.figure import Figure  # noqa: PLC0415

    rows = len(view.pictures)
    figure = Figure(figsize=(13, 4.2 * rows + 1.5), layout="constrained")
    panels = figure.subplots(rows, 3, squeeze=False)
    suggested = {pose.picture: pose for pose in found.poses}
    for number, axes in enumerate(panels):
        depth, camera = reduced(view.pictures[number], view.cameras[number])
        depth_m = np.where(depth > 0, depth * 1e-3, np.nan)
        axes[0].imshow(depth_m, cmap="viridis_r", vmax=4.0)
        axes[0].set_title(f"picture {number}: depth, arm as rendered (red)")
        _outline(axes[0], world, view.states[number], camera, "red")
        if number in suggested:
            better = replace(camera, pose=pose_of(suggested[number].pose))
            _outline(axes[0], world, view.states[number], better, "magenta")
            axes[0].set_title(f"picture {number}: arm at the given pose (red), at the fitted pose (magenta)")
        points = camera.points_m(depth_m)[np.isfinite(depth_m)]
        for panel, (x, y) in zip(axes[1:], ((0, 2), (0, 1)), strict=True):
            panel.plot(points[:, x], points[:, y], ",", color="tab:blue")
            if (state := view.states[number]) is not None:
                draw_arm(panel, world.body, state, "red", 2, (x, y))
            panel.set(aspect="equal", xlabel="x, m", ylabel=f"{'xyz'[y]}, m", title="points and arm")
            panel.set(xlim=(-1.6, 1.6), ylim=(-1.0, 1.6) if y == 2 else (-1.6, 1.6))
    title = "\n".join(f"{one.code}: {one.seen}" for one in found.findings) or "nothing wrong was found"
    figure.suptitle(title, fontsize=9, wrap=True)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise ConfigError("the picture cannot be written", got=f"{path}: {error}"[:200]) from error


def _outline(axes: Any, world: SpatialWorld, state: State | None, camera: DepthCamera, colour: str) -> None:
    if state is None:
        return
    arm = np.isfinite(arm_depth_m(camera, world.body.spheres_at(state)))
    if arm.any() and not arm.all():
        axes.contour(arm, levels=[0.5], colors=[colour], linewidths=1.2)


if __name__ == "__main__":
    sys.exit(main())
