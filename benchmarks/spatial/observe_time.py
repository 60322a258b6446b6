"""How long it takes to fuse a depth picture into the grid round the Panda, and to look points up in it.

    OMP_NUM_THREADS=1 python -m benchmarks.spatial.observe_time

Processor time of one core, medians over scenes and repetitions after a warm-up; the arm stands in every
picture.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import cspace.worlds.spatial
from benchmarks.command import arguments
from cspace.splits import Split
from cspace.worlds.spatial.obstacles.families import draw_layout
from cspace.worlds.spatial.obstacles.scenes import SpatialScenes
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.seeing.depth_picture import to_m, to_mm
from cspace.worlds.spatial.seeing.grid_box import grid_of
from cspace.worlds.spatial.seeing.noise import StructuredLight
from cspace.worlds.spatial.seeing.observed import lookup, observe, unseen_share
from cspace.worlds.spatial.seeing.placing import draw_cameras
from cspace.worlds.spatial.seeing.render import render_depth
from cspace.worlds.spatial.seeing.robot_pixels import drop_robot
from cspace.worlds.spatial.seeing.sight import sight
from cspace.worlds.spatial.seeing.surface_patches import distance_codes, patches
from cspace.worlds.spatial.seeing.views import CameraViews

PANDA = Path(cspace.worlds.spatial.__file__).with_name("robots") / "panda.json"
READY = ((0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),)
POINTS = 60_000


def taken_ms(work: Callable[[], object], times: int) -> list[float]:
    work()
    found = []
    for _ in range(times):
        began = time.thread_time()
        work()
        found.append(1e3 * (time.thread_time() - began))
    return found


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--times", type=int, default=9)
    options = parser.parse_args()
    arm = SerialArm.from_dict(json.loads(PANDA.read_bytes()))
    grid, rng = grid_of(arm), np.random.default_rng(0)
    radii = arm.spheres_m()[:, 3]
    spheres = np.concatenate((arm.sphere_centres_m(READY)[0], radii[:, None]), axis=1)
    points = rng.uniform(grid.low_m, grid.high_m, (POINTS, 3))
    arms = arm.sphere_centres_m(
        rng.uniform(arm.space.lower, arm.space.upper, (POINTS // len(radii), arm.dim))
    )
    rows: dict[str, list[float]] = {}
    for index in range(options.scenes):
        layout = draw_layout(SpatialScenes(floor=1.0), Split.TEST, 3, index)
        camera = draw_cameras(CameraViews(count=(1, 1)), rng, layout)[0]
        view = render_depth(layout.obstacles, camera, spheres)
        picture = to_mm(StructuredLight().apply(rng, view.depth_m, camera))
        kept = drop_robot(picture, camera, spheres)
        surface_m = to_m(kept.depth_mm)
        pieces = patches(surface_m, camera, grid)
        seen = observe([picture], [camera], grid, spheres)
        works: dict[str, Callable[[], object]] = {
            "observe, one picture": partial(observe, [picture], [camera], grid, spheres),
            "  the robot's pixels": partial(drop_robot, picture, camera, spheres),
            "  patches of surface": partial(patches, surface_m, camera, grid),
            "  distances": partial(distance_codes, pieces, grid),
            "  what is seen free": partial(sight, surface_m, kept.front_m, camera, grid),
            f"lookup of {POINTS} points": partial(lookup, seen, grid, points),
            f"unseen share of {len(arms)} arms": partial(unseen_share, seen, grid, arms, radii**3),
        }
        for name, work in works.items():
            rows.setdefault(name, []).extend(taken_ms(work, options.times))
    for name, values in rows.items():
        low, high = np.percentile(values, (5, 95))
        print(f"{name:32} median {statistics.median(values):6.2f} ms (5 to 95 %: {low:.2f} to {high:.2f})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
