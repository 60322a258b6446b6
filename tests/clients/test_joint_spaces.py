"""Joint spaces in answers: said in a header, and what the samples are held against."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cspace import space
from cspace_client import models
from cspace_client.answers import read_headers, read_samples
from cspace_client.errors import SamplerAnswerError
from cspace_client.models import JointSpace, ModelHead
from inference_api.routes.sample import npy_head

SAID = space.JointSpace((-np.pi, -4.0), (np.pi, 1.0), (True, False))
MIXED = JointSpace(SAID.lower, SAID.upper, SAID.periodic)
GOOD = SAID.to_dict()


def body(rows):
    samples = np.asarray(rows, dtype="<f4")
    return npy_head(samples.shape) + samples.tobytes()


def read_space(header):
    model = {"x-model-name": "m", "x-model-version": "1", "x-model-digest": "0" * 64}
    return read_headers(ModelHead, model | {"x-joint-space": header})["space"]


@pytest.mark.parametrize("said", [space.circles(3), SAID, space.JointSpace((-9.0,), (9.0,), (False,))])
def test_a_joint_space_survives_the_way_through_the_header(said):
    read = read_space(json.dumps(said.to_dict()))
    assert (read.lower, read.upper, read.periodic) == (said.lower, said.upper, said.periodic)


@pytest.mark.parametrize(
    "said",
    [
        "", "[]", "{", "null", '{"kind": "torus"}', '{"kind": "torus", "dim": 1000000000, "unit": "rad"}',
        json.dumps(GOOD | {"kind": "torus"}), json.dumps(GOOD | {"kind": "box"}),
        json.dumps(GOOD | {"dim": 3}), json.dumps(GOOD | {"unit": "deg"}),
        json.dumps(GOOD | {"lower": [-3.2, 1.0]}), json.dumps(GOOD | {"lower": [-1e300, -4.0]}),
        json.dumps(GOOD | {"lower": ["-3", "-4"]}), json.dumps(GOOD | {"upper": [3.2]}),
        json.dumps(GOOD | {"lower": None}), json.dumps(GOOD | {"periodic": ["yes", ""]}),
        json.dumps(GOOD | {"periodic": [1, 0]}), json.dumps(GOOD | {"lower": [True, -4.0]}),
        json.dumps(GOOD | {"periodic": [True, True], "kind": "torus"}),
        json.dumps(GOOD | {"lower": [1.0, 1.0]}),
        json.dumps(GOOD).replace("-4.0", "NaN"), json.dumps(GOOD) + " " * 9000 + "x", "\ud800",
    ],
)  # fmt: skip
def test_a_header_that_says_no_joint_space_is_refused(said):
    with pytest.raises(SamplerAnswerError, match="x-joint-space"):
        read_space(said)


def test_samples_within_limits_beyond_half_a_turn_are_taken():
    rows = [[3.0, -3.9], [-3.1, 1.0]]
    np.testing.assert_array_equal(read_samples(body(rows), 2, MIXED), np.float32(rows))
    with pytest.raises(SamplerAnswerError, match="no wrapped angles"):
        read_samples(body(rows), 2)


def test_samples_outside_the_limits_or_of_another_number_of_joints_are_refused():
    for row in ([0.0, 1.1], [0.0, -4.1], [3.2, 0.0], [0.0, np.nan], [np.inf, 0.0]):
        with pytest.raises(SamplerAnswerError, match="outside the joints' limits"):
            read_samples(body([[0.0, 0.0], row]), 2, MIXED)
    with pytest.raises(SamplerAnswerError, match="another joint space"):
        read_samples(body([[0.0, 0.0, 0.0]]), 1, MIXED)


@given(arrays(np.float64, (4, 2), elements=st.floats(-20.0, 20.0)))
def test_the_clients_joint_space_is_the_projects(rows):
    np.testing.assert_array_equal(MIXED.wrap(rows), SAID.wrap(rows))
    # Three turns are less than 20 rad.
    near = np.abs(rows[:, 0]) <= models.MAX_CIRCLE_RAD
    np.testing.assert_array_equal(MIXED.admits(rows), SAID.contains(rows) & near)
    for values in (rows, rows.astype(np.float32)):
        np.testing.assert_array_equal(MIXED.holds(values), SAID.holds(values))
    drawn = [one.sample_uniform(np.random.default_rng(3), 5) for one in (MIXED, SAID)]
    np.testing.assert_array_equal(*drawn)


def test_the_client_rounds_to_limits_as_the_service_does():
    assert models.LIMIT_TOLERANCE_RAD == space.LIMIT_TOLERANCE_RAD
    assert models.MAX_CIRCLE_RAD == space.MAX_CIRCLE_RAD
    rows = [[0.0, 1.0 + 1e-10], [0.0, -4.00009], [7.0, 0.5], [0.0, 1.001]]
    clamped = MIXED.clamp(rows)
    np.testing.assert_array_equal(clamped, [[0.0, 1.0], [0.0, -4.0], [7.0, 0.5], [0.0, 1.001]])
    assert MIXED.admits(clamped).tolist() == [True, True, True, False]
    assert not MIXED.admits([90.0, 0.5])
