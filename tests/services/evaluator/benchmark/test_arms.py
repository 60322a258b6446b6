import pytest

from cspace.errors import ConfigError
from services.evaluator.benchmark.arms import MIN_CONFIDENCE, SAMPLES, Group, Taken, pick, table
from services.planner.planning import PAPER_SCHEDULE
from services.planner.settings import LEARNED_PLANNERS

ARMS = table(["flow", "way"], 1.0)


def names(*wanted, planners=()):
    return [arm.name for arm in pick(ARMS, wanted, planners)]


def test_every_arm_has_its_own_name_and_a_base_with_uniform_samples():
    by_name = {arm.name: arm for arm in ARMS}
    assert len(by_name) == len(ARMS)
    for arm in ARMS:
        base = by_name[arm.base]
        assert base.sampler is None
        assert base.planner == arm.planner or arm.group is Group.OPTIMISING
        assert base.stop_at_first is arm.stop_at_first


def test_every_planner_that_can_draws_each_sampler_at_both_shares():
    learned = [arm for arm in ARMS if arm.group is Group.LEARNED]
    found = {(arm.planner, arm.sampler, arm.learned_share) for arm in learned}
    assert found == {(p, s, share) for p in LEARNED_PLANNERS for s in ("flow", "way") for share in (0.7, 1.0)}
    assert all(arm.samples == SAMPLES and arm.min_confidence == 0.0 for arm in learned)


def test_the_schedule_has_as_many_unperturbed_samples_as_the_mixture_it_is_compared_with():
    mixed, in_order, uniform = (a for a in ARMS if a.group is Group.SCHEDULE and a.sampler == "way")
    assert mixed.epsilon_sigma == in_order.epsilon_sigma == PAPER_SCHEDULE
    assert (mixed.in_order, in_order.in_order) == (False, True)
    assert uniform.samples == mixed.samples // len(PAPER_SCHEDULE)
    assert uniform.learned_share == 1.0 / len(PAPER_SCHEDULE)


def test_arms_ask_for_as_many_samples_as_they_are_told_and_keep_a_number_that_is_in_their_name():
    arms = {arm.name: arm for arm in table(["way"], 1.0, Taken(samples=700))}
    plain = {arm.name: arm.samples for arm in table(["way"], 1.0) if arm.group is not Group.SCHEDULE}
    changed = {name for name, samples in plain.items() if arms[name].samples != samples}
    assert changed == {
        name for name, samples in plain.items() if samples == SAMPLES and "samples" not in name
    }
    assert {arms[name].samples for name in changed} == {700}
    assert arms["RRT, way, 70 %, 30 samples"].samples == 30
    assert arms["RRT, way, 25 %, 175 samples"].samples == 175


def test_there_is_an_arm_for_every_share_that_is_told():
    plain, changed = table(["way"], 1.0), table(["way"], 1.0, Taken(shares=(0.85, 0.55)))
    assert len(changed) == len(plain)
    shared = (Group.LEARNED, Group.FILTERED, Group.ORDERED, Group.CHECKED)
    assert {arm.learned_share for arm in changed if arm.group in shared} == {0.85, 0.55}
    by_name = {arm.name: arm for arm in changed}
    assert by_name["RRT, way, 55 %, colliding last"].learned_share == 0.55
    assert by_name["RRT*, way, 85 %, optimising"].learned_share == 0.85
    assert by_name["RRT, way, 70 %, 30 samples"].learned_share == 0.7


def test_checked_arms_take_the_samples_as_they_come_but_for_those_that_collide():
    checked = [arm for arm in table(["way"], 1.0) if arm.group is Group.CHECKED]
    assert len(checked) == 8
    for arm in checked:
        assert (arm.colliding_last, arm.min_confidence, arm.epsilon_sigma) == (True, 0.0, (0.0,))
        assert arm.ordered is ("ordered" in arm.name)
    assert not any(arm.colliding_last for arm in table(["way"], 1.0) if arm.group is not Group.CHECKED)


def test_a_confidence_filters_ordered_arms_too_and_where_it_drops_nothing_no_arm_is_called_filtered():
    arms = table(["way"], 1.0, Taken(0.25))
    assert {arm.min_confidence for arm in pick(arms, ["filtered", "ordered"]) if arm.sampler} == {0.25}
    arms = table(["way"], 1.0, Taken(0.0))
    with pytest.raises(ConfigError, match="no arm is left"):
        pick(arms, ["filtered"])
    assert {arm.min_confidence for arm in pick(arms, ["ordered"])} == {0.0}


def test_arms_are_picked_by_name_or_group_and_bring_their_bases():
    assert names("RRT, way, 70 %") == ["RRT, uniform", "RRT, way, 70 %"]
    assert len(names("learned", planners=["PRM"])) == 1 + 2 * 2
    assert {arm.min_confidence for arm in pick(ARMS, ["filtered"])} == {0.0, MIN_CONFIDENCE}


@pytest.mark.parametrize(
    ("wanted", "planners", "words"),
    [
        (["nothing"], [], "no such arm"),
        (["uniform"], ["EST"], "planner is unknown"),
        (["filtered"], ["PRM"], "no arm is left"),
    ],
)
def test_what_is_not_there_is_refused(wanted, planners, words):
    with pytest.raises(ConfigError, match=words):
        pick(ARMS, wanted, planners)
