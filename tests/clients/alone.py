"""Runs every call of the client once, against answers of its own wire models; for tests/clients/newest.sh."""

import sys

import httpx
import numpy as np
import pydantic

from cspace_client import DepthPictures, OutcomeSender, PlanQuery, SamplingClient
from cspace_client.wire import (
    JointSpaceInfo,
    ModelInfo,
    PlanAnswer,
    SampleAnswer,
    ScenarioInfo,
    ValidityAnswer,
)

ABOUT = {
    "scenario": ScenarioInfo(novelty=0.5),
    "warnings": [],
    "joint_space": JointSpaceInfo(kind="torus", dim=2),
    "model": ModelInfo(name="m", version=1, digest="f" * 64),
    "timing_ms": dict.fromkeys(("decode", "encode", "generate", "search", "score", "total"), 1.0),
}
ROWS = np.array([[0.5, -1.0], [1.0, 2.0]])
PLAN = {"status": "solved", "reason": None, "path": ROWS, "confidence": 0.9, "edges": [0.9], "unseen": None}
ANSWERS = {
    "/sample": SampleAnswer.model_construct(
        samples=ROWS, confidence=None, shortfall=0, acceptance=1.0, seed=7, **ABOUT
    ),
    "/validity": ValidityAnswer.model_construct(confidence=[0.5, 0.9], unseen=None, threshold=0.5, **ABOUT),
    "/plan": PlanAnswer.model_construct(
        **PLAN, length_rad=3.0, ways=1, least_sure=None, alternatives=None, seed=7, **ABOUT
    ),
}


def handle(request):
    """The answer of an endpoint."""
    request.read()
    headers = {"X-Request-ID": "r-1"}
    if request.url.path == "/outcomes":
        return httpx.Response(202, json={"kept": 1})
    body = ANSWERS[request.url.path].model_dump_json(warnings=False)
    return httpx.Response(200, content=body, headers=headers)


pose = {"translation": [0.0, 0.0, 1.0], "quaternion_xyzw": np.array([0.0, 0.0, 0.0, 1.0])}
camera = {"fx": 50.0, "fy": 50.0, "cx": 31.5, "cy": 23.5, "pose": pose}
picture = DepthPictures([np.full((48, 64), 1000, np.uint16)], [camera], np.zeros(2))
with SamplingClient("http://test", transport=httpx.MockTransport(handle)) as client:
    batch = client.sample(picture, 2, epsilon_sigma=np.array([0.0, 0.5]))
    found = client.plan(picture, PlanQuery(start=ROWS[0], goal=ROWS[1], max_risk=0.2))
    predictions = client.validity(picture, ROWS)
np.testing.assert_array_equal(batch.samples, ROWS)
np.testing.assert_array_equal(found.path, ROWS)
np.testing.assert_allclose(predictions.confidence, [0.5, 0.9])
with OutcomeSender("http://test", transport=httpx.MockTransport(handle)) as outcomes:
    outcomes.plan(found, success=True)
assert (outcomes.sent, outcomes.dropped) == (1, 0)
versions = f"numpy {np.__version__}, httpx {httpx.__version__}, pydantic {pydantic.VERSION}"
sys.stdout.write(f"Python {sys.version.split()[0]}, {versions}: the client works\n")
