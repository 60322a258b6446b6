import math

import pytest

from services.planner.report import problem_line
from tests.services.planner.conftest import problem_of


@pytest.mark.parametrize(
    ("bottleneck_rad", "end"),
    [(0.25, ", bottleneck 0.250 rad"), (0.0, ", no path"), (math.inf, ", nothing in reach"), (math.nan, "")],
)
def test_a_problem_says_how_narrow_it_is_where_that_is_known(bottleneck_rad: float, end: str) -> None:
    assert problem_line(problem_of(bottleneck_rad=bottleneck_rad)) == f"uniform, seed 0, 2 joints{end}"
