"""Several pictures in one request of the Open Inference Protocol: each is answered as it would be alone."""

import numpy as np
import pytest

from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import IMAGES, binary_request, infer, outputs_of, sampled


def test_every_picture_is_answered_as_it_would_be_alone_with_the_next_seed(api: ApiClient) -> None:
    answer = infer(
        api, "cspace-sampler", **binary_request(IMAGES, parameters={"n": 50, "seed": str(2**64 - 2)})
    )
    found = outputs_of(answer)
    assert found["samples"].shape == (3, 50, 2)
    assert found["seed"].tolist() == [2**64 - 2, 2**64 - 1, 0]
    for image, seed, samples in zip(IMAGES, found["seed"].tolist(), found["samples"], strict=True):
        alone = sampled(api, image, n=50, seed=str(seed))["samples"]
        assert np.array_equal(samples, np.array(alone, np.float32))


def test_the_shortfall_is_told_for_each_picture(api: ApiClient) -> None:
    images = np.stack([IMAGES[0], np.zeros_like(IMAGES[0])])
    fields = {"n": 100, "min_confidence": 0.4}
    request = binary_request(images, parameters={**fields, "seed": 5, "binary_data_output": True})
    found = outputs_of(infer(api, "cspace-sampler@scored", **request))
    alone = [
        sampled(api, image, model="cspace-sampler@scored", seed=5 + index, **fields)["shortfall"]
        for index, image in enumerate(images)
    ]
    assert alone[0] < alone[1] == 100
    assert found["shortfall"].tolist() == alone
    assert (found["samples"].shape, found["confidence"].shape) == ((2, 0, 2), (2, 0))


def test_the_novelty_of_each_picture_is_told(api: ApiClient) -> None:
    images = np.stack([np.full((48, 48, 3), level, np.uint8) for level in (150, 255)])
    request = binary_request(images, parameters={"n": 5, "min_confidence": 0})
    fields = {"model": "cspace-sampler@careful", "n": 5, "min_confidence": 0}
    expected = [sampled(api, image, **fields)["scenario"]["novelty"] for image in images]
    assert expected[0] != expected[1]
    for _ in range(2):
        found = outputs_of(infer(api, "cspace-sampler@careful", **request))["novelty"]
        assert found.dtype == np.float32
        assert found.tolist() == pytest.approx(expected)
    assert "novelty" not in outputs_of(infer(api, "cspace-sampler", **request))
