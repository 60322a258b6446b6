import pytest

from cspace.errors import ConfigError
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation.units import FULL, QUICK, Setting, make_request, units


@pytest.mark.parametrize("text", ["", "cspace-sampler", "a/0", "a/x", "a@", "@b", "a@b/1", "../a/1", "a/1\n"])
def test_other_references_are_errors(text):
    with pytest.raises(ConfigError, match="name@alias or name/version"):
        make_request(text)


def test_the_quick_budget_is_the_default_and_its_scenarios_can_be_set():
    assert make_request("a/1").budget == QUICK
    request = make_request("a/1", budget="full", scenarios=7, seed=3, promote=False)
    assert (request.budget.scenarios, request.budget.draws) == (7, FULL.draws)
    assert (request.seed, request.promote) == (3, False)


@pytest.mark.parametrize("changes", [{"budget": "huge"}, {"scenarios": 0}, {"seed": -1}, {"seed": 2**63}])
def test_values_out_of_range_are_errors(changes):
    with pytest.raises(ConfigError):
        make_request("a/1", **changes)


def test_units_cover_every_scenario_and_problem_once():
    work = units(Setting(PlanarWorld(), 0, QUICK))
    seen = [
        (unit.kind, unit.split, unit.family, index)
        for unit in work
        for index in range(unit.first, unit.first + unit.count)
    ]
    assert len(seen) == len(set(seen))
    problems = 2 * (QUICK.validation_problems + QUICK.test_problems)
    scenarios = 2 * (QUICK.scenarios + QUICK.disconnected_scenarios)
    assert len(seen) == scenarios + QUICK.topology_scenarios + problems
