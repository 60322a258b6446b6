"""The Python client against the app."""

from typing import Any

import numpy as np
import pytest

import cspace_client
from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, robot_digest, simulator_of
from cspace_client import PlanQuery, SamplerError, SamplerUnavailableError
from tests.bundles import picture
from tests.inference_api.client_transports import IntoApp

CAREFUL = "cspace-sampler@careful"
WORLD = examples()["two-link"]
PROBLEM = simulator_of(WORLD).problem("uniform", Split.VALIDATION, 0, 0)
PNG = encode_png(simulator_of(WORLD).render(PROBLEM.scenario))
ROWS = np.array([[0.1, 0.2], [3.0, -3.0], [-1.5, 1.0]])
QUERY = PlanQuery(start=PROBLEM.start, goal=PROBLEM.goal, seed=3, time_limit_s=10.0)


@pytest.fixture
def ask(api):
    """One call of the client."""

    def call(name: str, *values: Any, **options: Any) -> Any:
        with cspace_client.SamplingClient("http://localhost", 60.0, transport=IntoApp(api)) as client:
            return getattr(client, name)(*values, **options)

    return call


def test_samples_are_those_that_the_api_answers_with(ask, api):
    batch = ask("sample", picture(), 20, 7, model=CAREFUL, min_confidence=0.0)
    form = {"n": "20", "seed": "7", "model": CAREFUL, "min_confidence": "0"}
    answer = api.post("/sample", files={"image": encode_png(picture())}, data=form).json()
    np.testing.assert_array_equal(batch.samples, np.float32(answer["samples"]))
    np.testing.assert_array_equal(batch.confidence, np.float32(answer["confidence"]))
    assert (batch.seed, batch.model_name, batch.robot) == (7, "cspace-sampler", robot_digest(WORLD))
    assert batch.request_id
    assert batch.server_s > 0.0


def test_confidences_are_those_of_the_model(ask, api):
    found = ask("validity", picture(), ROWS, CAREFUL)
    answer = api.post("/validity", files={"image": encode_png(picture())},
                      data={"model": CAREFUL, "configurations": str(ROWS.tolist())}).json()  # fmt: skip
    assert np.allclose(found.confidence, answer["confidence"], atol=1e-6)
    assert found.unseen is None
    assert found.threshold == answer["threshold"] == 0.45
    assert found.scenario.novelty == pytest.approx(answer["scenario"]["novelty"], abs=1e-5)


def test_a_path_and_its_alternatives_come_as_arrays(ask):
    plan = ask("plan", PNG, QUERY.model_copy(update={"alternatives": True}), CAREFUL)
    assert (plan.status, plan.reason, plan.seed) == ("solved", None, 3)
    assert np.allclose(plan.path[[0, -1]], [PROBLEM.start, PROBLEM.goal], atol=1e-6)
    assert len(plan.edges) == len(plan.path) - 1
    assert plan.least_sure.confidence == pytest.approx(float(plan.edges.min()), abs=1e-6)
    assert len(plan.alternatives) == plan.ways == 4
    np.testing.assert_array_equal(plan.alternatives[0].path, plan.path)
    assert plan.contact is None
    assert plan.round_trip_s > 0.0


def test_what_is_not_sure_enough_comes_with_the_reason_and_refusals_in_the_apis_words(ask):
    found = ask("plan", PNG, QUERY.model_copy(update={"min_confidence": 1.0}), CAREFUL)
    assert (found.status, len(found.path)) == ("refused", 0)
    assert f"{found.confidence:.3f}" in found.reason
    with pytest.raises(SamplerError, match="validity head") as caught:
        ask("plan", PNG, QUERY, "cspace-sampler")
    assert not isinstance(caught.value, SamplerUnavailableError)
    with pytest.raises(SamplerError, match="start"):
        ask("plan", PNG, QUERY.model_copy(update={"start": [0.0]}), CAREFUL)
