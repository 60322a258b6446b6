"""A bundle in place of a server, by what is installed."""

import httpx
import numpy as np
import pytest

import cspace.query
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from cspace_client import (
    DepthPictures,
    JointSpace,
    Known,
    LocalError,
    PlanarPicture,
    SampleQuery,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
    SamplingClient,
    local,
)
from cspace_client.local import LocalClient
from services.planner.client import ClientSource
from services.planner.samples import LocalSampler
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.sample_source import FakeSampleSource
from tests.inference_api.test_depth_pictures import CAMERAS, IMAGES, STATE
from tests.space_bundle import write_space_bundle

OTHER = "0" * 64


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_tiny_bundle(tmp_path_factory.mktemp("local") / "bundle", validity=True)


@pytest.fixture(scope="module")
def client(folder):
    return LocalClient(folder)


def test_a_bundle_answers_as_the_projects_own_sampler(folder, client):
    options = {"seed": 7, "epsilon_sigma": [0, 0.5], "min_confidence": 0.4}
    ours, theirs = (
        LocalSampler(folder).sample(picture(), 50, **options),
        client.sample(picture(), 50, **options),
    )
    assert np.array_equal(ours.samples, theirs.samples)
    assert (ours.digest, ours.shortfall) == (theirs.digest, theirs.shortfall)
    assert theirs.space == JointSpace((-np.pi,) * 2, (np.pi,) * 2, (True,) * 2)


def test_a_bundle_keeps_clear_of_known_discs(client):
    disc = Disc(1.5, 1.0, 0.5)
    pole = {"name": "pole", "disc": {"x_m": disc.x_m, "y_m": disc.y_m, "radius_m": disc.radius_m}}
    known = client.sample(PlanarPicture(picture(), Known([pole])), 200, seed=7)
    checker = CollisionChecker(Scenario(TWO_LINK, (disc,)))
    assert len(known.samples) == 200
    assert checker.valid_batch(known.samples).all()
    plain = client.sample(picture(), 200, seed=7)
    assert not checker.valid_batch(plain.samples).all()
    again = client.sample(PlanarPicture(picture(), Known()), 200, seed=7)
    assert np.array_equal(again.samples, plain.samples)


@pytest.mark.slow
def test_a_bundle_takes_what_depth_cameras_saw(tmp_path):
    client = LocalClient(write_space_bundle(tmp_path / "space"))
    batch = client.sample(DepthPictures(IMAGES, CAMERAS, STATE), 20, seed=3)
    again = client.sample(DepthPictures(IMAGES[:1], CAMERAS[:1]), 20, seed=3)
    assert batch.samples.shape == again.samples.shape == (20, 7)


def test_a_request_that_does_not_fit_is_refused_in_the_clients_words(client):
    for model, robot in (("nobody", None), (None, OTHER)):
        with pytest.raises(SamplerError):
            client.answer(picture(), SampleQuery(n=3), model, robot)


def test_what_keeps_a_bundle_from_being_read_is_told_with_the_remedy(monkeypatch, tmp_path):
    class Broken:
        def load(self):
            raise ModuleNotFoundError("No module named 'onnxruntime'")

    with pytest.raises(LocalError, match="can not be used"):
        LocalClient(tmp_path)
    for found, words in (
        ([], "install onnxruntime and cspace-sampler"),
        ([Broken()], "'onnxruntime'.*install"),
    ):
        monkeypatch.setattr(local, "entry_points", lambda group, found=found: found)
        with pytest.raises(LocalError, match=words):
            LocalClient(tmp_path)


def test_a_bundle_stands_in_and_its_refusal_leaves_the_servers_absence_to_be_told(client):
    away = httpx.MockTransport(lambda request: httpx.Response(502))
    with SamplingClient("http://test:1", fallback=client, transport=away) as over_http:
        assert over_http.sample(picture(), 3, seed=1).fallback
        with pytest.raises(SamplerUnavailableError, match="502"):
            over_http.answer(picture(), SampleQuery(n=3), robot=OTHER)


def test_a_source_of_the_project_gets_its_own_query_and_raises_the_clients_errors():
    source, query = FakeSampleSource(), SampleQuery(n=3, seed=7)
    ClientSource(source).answer(b"\x89PNG", query, robot=OTHER)
    assert source.requests[0].query == cspace.query.SampleQuery(3, 7, robot=OTHER)
    with pytest.raises(SamplerUnavailableError):
        ClientSource(FakeSampleSource(ready=False)).answer(b"\x89PNG", query)
    with pytest.raises(SamplerError) as caught:
        ClientSource(source).answer(b"\x89PNG", SampleQuery(n=3, seed=7, start=[0.0, 0.0]))
    assert not isinstance(caught.value, SamplerUnavailableError | SamplerModelError)
