import numpy as np
import pytest

from training.clusters.calibration import Scored, choose_threshold


def scene(confident_right=900, unsure_wrong=100, confident_wrong=0):
    confidence = np.r_[
        np.full(confident_right, 0.97), np.full(unsure_wrong, 0.62), np.full(confident_wrong, 0.97)
    ]
    free = np.r_[np.full(confident_right, 1), np.zeros(unsure_wrong + confident_wrong)].astype(bool)
    return Scored(confidence, free)


NOTHING = Scored(np.full(10, 0.7), np.zeros(10, dtype=bool))


@pytest.mark.parametrize(
    ("scenes", "threshold"),
    [
        ([scene()] * 10, 0.65),
        ([scene(unsure_wrong=0)] * 10, 0.5),
        ([scene(confident_wrong=300)] * 10, 0.95),
        ([scene(), NOTHING], 0.95),
    ],
    ids=["mistakes kept out", "no mistakes", "none is enough", "nothing passes in one"],
)
def test_the_lowest_threshold_is_chosen_that_is_precise_enough_or_the_highest(scenes, threshold):
    assert choose_threshold(scenes, 0.99) == pytest.approx(threshold)


def test_scenarios_that_fail_count_even_where_the_mean_does_not_show_them():
    scenes = [scene(confident_right=3000, unsure_wrong=0)] * 8 + [scene(900, 28)] * 2
    assert np.mean([rows.free.mean() for rows in scenes]) > 0.99
    assert choose_threshold(scenes, 0.99) == pytest.approx(0.65)
