from dataclasses import replace

import pytest

from cspace.errors import ConfigError
from services.planner.settings import PLANNERS, PlannerSettings


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("planner", "LazyPRM"),
        ("range_rad", 0.0),
        ("range_rad", float("inf")),
        ("resolution_rad", -0.1),
        ("time_limit_s", 0.0),
        ("goal_bias", 1.01),
        ("goal_bias", float("nan")),
        ("max_iterations", 0),
        ("seed", -1),
        ("seed", 2**64),
    ],
)
def test_a_value_out_of_range_is_an_error_that_names_it(name, value):
    with pytest.raises(ConfigError) as caught:
        replace(PlannerSettings(), **{name: value})
    assert name in str(caught.value)
    assert repr(value) in str(caught.value)


def test_the_extreme_values_are_taken():
    for planner in PLANNERS:
        assert PlannerSettings(planner, seed=2**64 - 1, goal_bias=0.0, max_iterations=1).goal_bias == 0.0
