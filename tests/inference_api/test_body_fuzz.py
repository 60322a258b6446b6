"""Bodies drawn by structure: whatever comes, the answer is one of the contract's, and never a failure."""

import random

import pytest

from inference_api.limits import MAX_BODY_BYTES
from tests.inference_api.answers import assert_answers
from tests.inference_api.body_fuzz import form, picture, sample_json, tensors
from tests.inference_api.client import ApiClient

FINE, REFUSED = {200}, {400, 404, 413, 415, 422}


@pytest.mark.parametrize("kind", [picture, form, sample_json, tensors])
def test_no_body_makes_the_server_fail(api: ApiClient, kind) -> None:
    rng = random.Random(kind.__name__)  # noqa: S311 - the same bodies every time
    found = set()
    for index in range(50):
        request = kind(rng)
        assert len(request.body) <= MAX_BODY_BYTES
        headers = {name: value.encode("latin-1") for name, value in request.headers.items()}
        answer = api.post(request.path, headers=headers, content=request.body)
        assert answer.status_code in FINE | REFUSED, (index, request.path, request.headers, answer.text)
        found.add(answer.status_code)
    assert found & REFUSED
    assert_answers(api)
