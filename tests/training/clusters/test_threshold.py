import numpy as np
import pytest

from training.clusters.threshold import Scored, choose_threshold, choose_uniform_share


def scene(confident_right=900, doubtful_wrong=100, confident_wrong=0):
    confidence = np.r_[
        np.full(confident_right, 0.97), np.full(doubtful_wrong, 0.62), np.full(confident_wrong, 0.97)
    ]
    free = np.r_[np.full(confident_right, 1), np.zeros(doubtful_wrong + confident_wrong)].astype(bool)
    return Scored(confidence, free)


def test_the_lowest_threshold_that_keeps_the_mistakes_out_is_chosen():
    assert choose_threshold([scene()] * 10, 0.99) == pytest.approx(0.65)


def test_a_sampler_without_mistakes_needs_no_more_than_the_lowest():
    assert choose_threshold([scene(doubtful_wrong=0)] * 10, 0.99) == pytest.approx(0.5)


def test_scenarios_that_fail_count_even_where_the_mean_does_not_show_them():
    scenes = [scene(confident_right=3000, doubtful_wrong=0)] * 8 + [scene(900, 28)] * 2
    assert np.mean([rows.free.mean() for rows in scenes]) > 0.99
    assert choose_threshold(scenes, 0.99) == pytest.approx(0.65)


def test_without_a_threshold_that_is_enough_the_highest_is_recommended():
    assert choose_threshold([scene(confident_wrong=300)] * 10, 0.99) == pytest.approx(0.95)


def test_a_threshold_that_lets_nothing_pass_in_a_scenario_is_none():
    nothing = Scored(np.full(10, 0.7), np.zeros(10, dtype=bool))
    assert choose_threshold([scene(), nothing], 0.99) == pytest.approx(0.95)


def uniform(passing=0.6, wrong=0.0, size=1000):
    """Of so many a share passes, of which some are wrong."""
    count, bad = round(passing * size), round(wrong * size)
    confidence = np.r_[np.full(count, 0.9), np.full(size - count, 0.1)]
    return Scored(confidence, np.arange(size) < count - bad)


def test_as_many_uniform_proposals_are_mixed_in_as_the_acceptance_allows():
    learned = [uniform(passing=1.0)] * 10
    for passing, expected in ((0.8, 0.5), (0.5, 0.25), (0.1, 0.1), (0.0, 0.1)):
        found = choose_uniform_share(learned, [uniform(passing)] * 10, 0.5, 0.995, 0.85)
        assert found == expected


def test_uniform_proposals_that_the_head_mistakes_stay_out():
    learned = [uniform(passing=1.0)] * 10
    assert choose_uniform_share(learned, [uniform(0.8, wrong=0.05)] * 10, 0.5, 0.995, 0.85) == 0.05
    # One scenario in five is enough.
    some = [uniform(0.8)] * 8 + [uniform(0.8, wrong=0.4)] * 2
    assert choose_uniform_share(learned, some, 0.5, 0.995, 0.85) == 0.0


def test_a_sampler_of_which_too_little_passes_already_gets_none():
    assert choose_uniform_share([uniform(0.7)] * 4, [uniform(0.6)] * 4, 0.5, 0.995, 0.85) == 0.0
