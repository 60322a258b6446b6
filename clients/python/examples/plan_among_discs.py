"""Plan for an arm of two links among three discs, with learned samples and a collision checker of one's own.

    python plan_among_discs.py http://127.0.0.1:8000 discs.png

The picture shows the same discs, drawn as the project's models know them: ``docs/method.md`` of the project
tells how. Only ``numpy``, ``cspace-client`` and ``ompl`` are needed.
"""

import argparse
import math
import sys
from pathlib import Path

from cspace_client import SamplingClient
from cspace_client.ompl import Problem, learned_sampler

LINKS_M, HALF_WIDTH_M = (2.0, 2.0), 0.1
DISCS = [(-1.93, -0.31, 1.0), (-0.76, -3.35, 1.0), (1.74, -0.79, 1.0)]  # x, y, radius in m
START, GOAL = (-1.48, 2.98), (-1.73, 1.18)  # rad


def is_free(joints):
    """Whether the links are clear of all discs."""
    x = y = turned = 0.0
    for joint, length in zip(joints, LINKS_M, strict=True):
        turned += joint
        along = math.cos(turned), math.sin(turned)
        for disc_x, disc_y, radius in DISCS:
            nearest = min(max((disc_x - x) * along[0] + (disc_y - y) * along[1], 0.0), length)
            gap = math.hypot(disc_x - x - nearest * along[0], disc_y - y - nearest * along[1])
            if gap <= radius + HALF_WIDTH_M:
                return False
        x, y = x + length * along[0], y + length * along[1]
    return True


def main(url, picture):
    """Ask, plan, print; returns the exit code."""
    problem = Problem(Path(picture).read_bytes(), START, GOAL, is_free)
    with SamplingClient(url) as client:
        found = learned_sampler(problem, client, seed=7).solve(10.0)
    print(f"{found.learned_drawn} learned samples drawn, {found.state_checks} states checked")
    if found.path is None:
        return 1
    print("\n".join(" ".join(f"{angle:.3f}" for angle in row) for row in found.path))
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Plan among three discs with samples of the API.")
    parser.add_argument("url", help="of the API, such as http://127.0.0.1:8000")
    parser.add_argument("picture", help="of the same discs: discs.png beside this script")
    options = parser.parse_args()
    sys.exit(main(options.url, options.picture))
