"""Configurations along ways come in their order, and with growing noise."""

import numpy as np
import pytest

from cspace.planning.paths import NOISE_RAD, STEP_RAD, AlongPaths, spaced
from cspace.space import JointSpace

SPACE = JointSpace((-2.0, -2.0), (2.0, 2.0), (False, False))
WAYS = [np.array([[0.0, 0.0], [1.5, 0.0], [1.5, 1.0]]), np.array([[0.0, 0.0], [1.9, 1.9]])]


def stream(seed=0):
    return AlongPaths(WAYS, SPACE, np.random.default_rng(seed))


def test_the_first_turn_lies_on_the_ways_one_after_the_other():
    along = stream()
    rows, numbers = along.take(along.turn_rows)
    lines = [spaced(path, SPACE, STEP_RAD) for path in WAYS]
    np.testing.assert_array_equal(rows, np.concatenate(lines))
    np.testing.assert_array_equal(numbers, np.repeat([0, 1], [len(line) for line in lines]))


def test_what_is_taken_does_not_depend_on_how_many_are_taken_at_a_time():
    one, other = stream(), stream()
    whole = one.take(100)
    parts = [other.take(count) for count in (1, 30, 0, 69)]
    for index in range(2):
        np.testing.assert_array_equal(whole[index], np.concatenate([part[index] for part in parts]))


def test_later_turns_are_noisier_up_to_the_last_and_stay_within_limits():
    line = np.concatenate([spaced(path, SPACE, STEP_RAD) for path in WAYS])
    wide = AlongPaths(WAYS, JointSpace((-9.0, -9.0), (9.0, 9.0), (False, False)), np.random.default_rng(1))
    turns = wide.take((len(NOISE_RAD) + 2) * len(line))[0].reshape(-1, *line.shape)
    spread = (turns - line).std(axis=(1, 2))
    assert spread == pytest.approx((*NOISE_RAD, NOISE_RAD[-1], NOISE_RAD[-1]), rel=0.35)
    assert np.all(np.abs(stream().take(500)[0]) <= 2.0)
