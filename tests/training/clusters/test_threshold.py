import numpy as np
import pytest

from training.clusters.calibration import Scored, choose_threshold


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
