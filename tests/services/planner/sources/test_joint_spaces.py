"""Joint spaces in answers: said in a header, and what the samples are held against."""

import json

import numpy as np
import pytest

from cspace.errors import SamplerAnswerError
from cspace.space import JointSpace, circles
from inference_api.pages.sampling import npy_head
from services.planner.sources.questions.model_head import read_space
from services.planner.sources.questions.npy_body import read_samples

MIXED = JointSpace((-np.pi, -4.0), (np.pi, 1.0), (True, False))
GOOD = MIXED.to_dict()


def body(rows):
    samples = np.asarray(rows, dtype="<f4")
    return npy_head(samples.shape) + samples.tobytes()


@pytest.mark.parametrize("space", [circles(3), MIXED, JointSpace((-9.0,), (9.0,), (False,))])
def test_a_joint_space_survives_the_way_through_the_header(space):
    assert read_space(json.dumps(space.to_dict())) == space


@pytest.mark.parametrize(
    "said",
    [
        "", "[]", "{", "null", '{"kind": "torus"}', '{"kind": "torus", "dim": 1000000000, "unit": "rad"}',
        json.dumps(GOOD | {"kind": "torus"}), json.dumps(GOOD | {"kind": "box"}),
        json.dumps(GOOD | {"dim": 3}), json.dumps(GOOD | {"unit": "deg"}), json.dumps(GOOD | {"more": 1}),
        json.dumps(GOOD | {"lower": [-3.2, 1.0]}), json.dumps(GOOD | {"lower": [-1e300, -4.0]}),
        json.dumps(GOOD | {"lower": ["-3", "-4"]}), json.dumps(GOOD | {"upper": [3.2]}),
        json.dumps(GOOD | {"lower": None}), json.dumps(GOOD | {"periodic": ["yes", ""]}),
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


@pytest.mark.parametrize("row", [[0.0, 1.1], [0.0, -4.1], [3.2, 0.0], [0.0, np.nan], [np.inf, 0.0]])
def test_samples_outside_the_limits_are_refused(row):
    with pytest.raises(SamplerAnswerError, match="outside the joints' limits"):
        read_samples(body([[0.0, 0.0], row]), 2, MIXED)


def test_samples_of_another_number_of_joints_than_said_are_refused():
    with pytest.raises(SamplerAnswerError, match="another joint space"):
        read_samples(body([[0.0, 0.0, 0.0]]), 1, MIXED)
