"""A query is judged in itself, with no bundle and no runtime for graphs at hand."""

import dataclasses

import numpy as np
import pytest

from cspace.errors import InputError
from cspace.query import MAX_SEED, SampleQuery

WRONG = [
    {"n": 0}, {"n": 2.5}, {"n": True}, {"n": "3"},
    {"seed": -1}, {"seed": 2**64}, {"seed": None},
    {"epsilon_sigma": ()}, {"epsilon_sigma": [0.0, 10.1]}, {"epsilon_sigma": ("1",)},
    {"min_confidence": 1.1}, {"min_confidence": float("nan")}, {"min_confidence": True},
    {"start": "ab"}, {"start": 3.0}, {"goal": [[0.0]]}, {"goal": [0.0, float("inf")]},
]  # fmt: skip


@pytest.mark.parametrize("change", WRONG, ids=str)
def test_a_wrong_value_is_named_with_what_was_expected_and_what_came(change):
    with pytest.raises(InputError, match="expected") as caught:
        SampleQuery.checked(**{"n": 3, "seed": 0, **change})
    assert next(iter(change)) in caught.value.what
    assert caught.value.got is not None


def test_values_of_numpy_become_plain_ones_and_equal_queries_are_one():
    made = SampleQuery.checked(
        np.int64(3),
        np.uint64(MAX_SEED),
        epsilon_sigma=np.array([0.0, 0.5]),
        start=np.array([0.5, 1.0]),
        goal=(2, 3),
        min_confidence=np.float64(0.5),
    )
    assert made == SampleQuery(3, MAX_SEED, (0.0, 0.5), (0.5, 1.0), (2.0, 3.0), 0.5)
    assert len({made, dataclasses.replace(made)}) == 1
    assert {type(value) for value in (made.n, made.seed)} == {int}
    assert {type(value) for value in (*made.epsilon_sigma, *made.start, made.min_confidence)} == {float}
