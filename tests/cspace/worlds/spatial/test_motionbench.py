import gzip
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import DatasetError
from cspace.simulator import Split
from cspace.worlds.spatial.benchmark import (
    BENCH_FAMILIES,
    LIMITS_RAD,
    SHIPPED,
    problems,
    write_problems,
)
from cspace.worlds.spatial.bodies import clearance_m
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles
from tests.cspace.worlds.spatial.test_robots import PANDA

# By how much spheres that stick out by 10 mm reach into a shelf beside goals, mm.
TIGHT_GOALS = {("bookshelf_small", 9): -0.7, ("bookshelf_small", 29): -2.5}


def test_thirty_problems_of_seven_families_ship() -> None:
    found = problems(Split.VALIDATION)
    assert Counter(one.family for one in found) == dict.fromkeys(BENCH_FAMILIES, 30)
    assert [one.number for one in found] == [*range(1, 31)] * 7
    first = found[0]
    assert (len(first.obstacles.boxes), len(first.obstacles.cylinders)) == (4, 3)
    assert first.obstacles.boxes[0].half_m == (0.6, 0.5, 0.02)
    assert first.obstacles.boxes[0].pose[0] == (0.452155, 0.89194, 0.0, 0.589609)
    assert (first.obstacles.cylinders[0].radius_m, first.obstacles.cylinders[0].half_length_m) == (0.03, 0.07)
    assert first.start == (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
    assert first.goal[:2] == (1.489049, -0.146671)
    assert problems(Split.VALIDATION, families=("cage",)) == tuple(
        one for one in found if one.family == "cage"
    )


def test_starts_and_goals_that_ship_are_free_but_for_two_tight_ones() -> None:
    found, space = problems(Split.VALIDATION), PANDA.with_limits(LIMITS_RAD).space
    ends = np.array([(one.start, one.goal) for one in found])
    assert (ends >= space.lower).all()
    assert (ends <= space.upper).all()
    assert CollisionChecker(PANDA, Obstacles()).clearance(ends.reshape(-1, 7)).min() > 0.003
    collides = {}
    for problem, pair in zip(found, ends, strict=True):
        start, goal = clearance_m(problem.obstacles, PANDA.sphere_centres_m(pair), PANDA.spheres_m()[:, 3])
        assert start > 0.0
        if goal <= 0.0:
            collides[problem.family, problem.number] = round(1e3 * goal, 1)
    assert collides == TIGHT_GOALS


def test_what_is_written_reads_back_and_is_what_ships(tmp_path: Path) -> None:
    found = problems(Split.VALIDATION)
    path = write_problems(tmp_path / "new", Split.VALIDATION, found)
    shipped = SHIPPED / path.name
    assert gzip.decompress(path.read_bytes()) == gzip.decompress(shipped.read_bytes())
    assert problems(Split.VALIDATION, tmp_path / "new") == found


def test_test_problems_are_asked_for_with_a_folder(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"do not ship.*training\.motionbench fetch --out FOLDER"):
        problems(Split.TEST)
    with pytest.raises(DatasetError, match="cannot be read"):
        problems(Split.TEST, tmp_path)
    write_problems(tmp_path, Split.TEST, problems(Split.VALIDATION))
    with pytest.raises(DatasetError, match="numbers 31 to 100 of each family; got 210 problems"):
        problems(Split.TEST, tmp_path)
