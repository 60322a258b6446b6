"""One contract for what gives planners and metrics samples: fake, HTTP client, bundle, the real API (e2e).

The uniform baseline keeps the part of it that asks for no model and no picture.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import SamplerError, SamplerUnavailableError
from cspace.files import encode_png
from cspace.query import SampleQuery
from cspace.worlds.planar.arm import TWO_LINK
from services.planner.samples import LocalSampler, SampleSource, SamplingClient
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.sample_server import sample_server
from tests.fakes.sample_source import FakeSampleSource
from tests.fakes.uniform_sampler import UniformSampler
from tests.inference_api.server import api_server

PNG = encode_png(picture())
E2E = pytest.mark.e2e
KINDS = ["fake", "http", "local", pytest.param("api", marks=E2E)]
BASELINE_TOO = pytest.mark.parametrize("source", [*KINDS, "uniform"], indirect=True)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_bundle(tmp_path_factory.mktemp("contract") / "bundle", validity=True)


@pytest.fixture(scope="module")
def api_url(tmp_path_factory: pytest.TempPathFactory, bundle: Path) -> Iterator[str]:
    with api_server(tmp_path_factory.mktemp("api"), {"CSPACE_PRETRAINED_MODEL": str(bundle)}) as url:
        yield url


@pytest.fixture(params=KINDS)
def source(request: pytest.FixtureRequest, bundle: Path) -> Iterator[SampleSource]:
    if request.param == "fake":
        yield FakeSampleSource()
    elif request.param == "local":
        yield LocalSampler(bundle)
    elif request.param == "uniform":
        yield UniformSampler(TWO_LINK.space)
    elif request.param == "api":
        with SamplingClient(request.getfixturevalue("api_url")) as client:
            yield client
    else:
        with sample_server(FakeSampleSource()) as server, SamplingClient(server.url) as client:
            yield client


@pytest.fixture(params=KINDS)
def empty_source(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Callable[[], SampleSource]]:
    """Makes or opens a source that has no model."""
    if request.param == "fake":
        yield lambda: FakeSampleSource(ready=False)
    elif request.param == "local":
        yield lambda: LocalSampler(tmp_path / "nothing")
    elif request.param == "api":
        nothing = {"CSPACE_PRETRAINED_MODEL": str(tmp_path / "nothing")}
        with api_server(tmp_path, nothing) as url, SamplingClient(url) as client:
            yield lambda: client
    else:
        empty = FakeSampleSource(ready=False)
        with sample_server(empty) as server, SamplingClient(server.url) as client:
            yield lambda: client


@BASELINE_TOO
def test_a_batch_holds_as_many_wrapped_float32_angles_as_were_asked_for(source):
    batch = source.sample(PNG, 300, seed=3)
    assert batch.samples.shape == (300, 2)
    assert batch.samples.dtype == np.float32
    assert batch.shortfall == 0
    angles = batch.samples.astype(np.float64)
    assert np.all((angles >= -np.pi) & (angles < np.pi))


def test_a_batch_names_its_model_and_the_seed_that_was_asked_for(source):
    batch = source.sample(PNG, 5, model="pretrained", seed=2**64 - 1, epsilon_sigma=(0.0, 0.5))
    assert batch.seed == 2**64 - 1
    assert (batch.model_name, batch.model_version) == ("pretrained", 0)
    assert len(batch.digest) == 64
    assert batch.round_trip_s >= 0.0


@BASELINE_TOO
def test_the_same_seed_drawn_or_asked_for_gives_the_same_samples_and_another_one_others(source):
    first, again, other = (source.sample(PNG, 20, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.samples, again.samples)
    assert not np.array_equal(first.samples, other.samples)
    drawn = source.sample(PNG, 20)
    assert np.array_equal(source.sample(PNG, 20, seed=drawn.seed).samples, drawn.samples)


@BASELINE_TOO
def test_pixels_are_as_good_as_their_file_and_a_query_as_its_arguments(source):
    by_query = source.answer(picture(), SampleQuery(20, 3, (0.0, 0.5)))
    assert np.array_equal(source.sample(PNG, 20, 3, epsilon_sigma=[0, 0.5]).samples, by_query.samples)


@BASELINE_TOO
@pytest.mark.parametrize(
    "wrong",
    [{"n": 2.5}, {"seed": 2**64}, {"start": "here"}],
    ids=str,
)
def test_a_value_out_of_range_is_refused_by_name(source, wrong):
    with pytest.raises(SamplerError, match=next(iter(wrong))):
        source.sample(PNG, **{"n": 10, **wrong})


def test_the_shortfall_is_what_is_missing(source):
    batch = source.sample(PNG, 200, seed=1, min_confidence=0.7)
    assert 0 < batch.shortfall < 200
    assert len(batch.samples) == 200 - batch.shortfall


def test_the_confidence_of_each_sample_comes_with_it(source):
    batch = source.sample(PNG, 200, seed=1, min_confidence=0.7)
    assert batch.confidence.shape == (len(batch.samples),)
    assert batch.confidence.dtype == np.float32
    assert np.all((batch.confidence >= np.float32(0.7)) & (batch.confidence <= 1.0))
    assert len(np.unique(batch.confidence)) > 1


def test_a_refused_request_is_an_error_and_the_next_request_is_answered(source):
    ends = {"start": [0.0, 0.0], "goal": [1.0, 1.0]}
    for picture_, n, changes in (
        (PNG, 0, {}),
        (PNG, 20_001, {}),
        (PNG, 10, {"model": "nobody/1"}),
        (PNG, 10, ends),
        (b"no picture", 10, {}),
    ):
        with pytest.raises(SamplerError) as caught:
            source.sample(picture_, n, **changes)
        assert not isinstance(caught.value, SamplerUnavailableError)
    assert len(source.sample(PNG, 4, seed=1).samples) == 4


def test_a_source_without_a_model_is_unavailable(empty_source):
    with pytest.raises(SamplerUnavailableError):
        empty_source().sample(PNG, 10)


@pytest.mark.e2e
def test_a_bundle_here_and_behind_the_api_gives_the_same_samples(bundle: Path, api_url: str) -> None:
    options = {"seed": 11, "epsilon_sigma": (0.0, 0.3), "min_confidence": 0.4}
    here = LocalSampler(bundle).sample(PNG, 150, **options)
    with SamplingClient(api_url) as client:
        there = client.sample(PNG, 150, **options)
    assert there.samples.tobytes() == here.samples.tobytes()
    assert (there.digest, there.shortfall) == (here.digest, here.shortfall)
