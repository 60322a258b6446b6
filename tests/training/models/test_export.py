from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.space import circles
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.config import ValidityConfig
from training.models.autoencoders import Decoder, Encoder, NoveltyScores
from training.models.export import encoder_graph, generator_graph, novelty_graph
from training.models.families.wgan_gp import MeansGenerator, Sizes, TorusGenerator, TorusSampler
from training.models.validity import make_head, validity_graph


def check(graph, network, *feeds, atol=1e-5):
    """A graph answers as its network does whatever feeds it gets, and names no folder of this machine."""
    assert b".py" not in graph
    assert str(Path(torch.__file__).parent).encode() not in graph
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    for fed in feeds:
        with torch.no_grad():
            expected = network(*fed.values())
        found = session.run(None, {name: value.numpy() for name, value in fed.items()})
        expected = expected if isinstance(expected, tuple) else (expected,)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other.numpy(), atol=atol)


def pictures(count=1):
    return torch.rand(count, 3, 48, 48) * 2.0 - 1.0


@pytest.mark.slow
def test_the_encoders_graph_answers_as_the_network_for_any_number_of_pictures():
    encoder = Encoder((3, 48, 48), 6, 4, 4)

    def mu_and_sigma(images):
        mu, log_variance = encoder(images)
        return mu, (log_variance / 2.0).exp()

    feeds = [{"image": pictures(count)} for count in (1, 5)]
    check(encoder_graph(encoder, 48), mu_and_sigma, *feeds, atol=5e-7)


@pytest.mark.slow
def test_the_torus_generators_graph_answers_as_the_network():
    generator = TorusGenerator(Sizes(circles(3), 6, 16, 2), 2)
    feeds = [
        {"latent": torch.randn(count, 6), "base": torch.randn(count, 3), "noise": torch.randn(count, 2)}
        for count in (1, 33)
    ]
    check(generator_graph(TorusSampler(generator), 6), generator, *feeds)


@pytest.mark.slow
def test_the_means_generators_graph_answers_as_the_network():
    generator = MeansGenerator(Sizes(circles(2), 6, 16, 2), 4, 0.1, (torch.zeros(2), torch.ones(2)))
    feeds = {"latent": torch.randn(9, 6), "noise": torch.randn(9, 4, 2)}
    check(generator_graph(generator, 6), generator, feeds)


@pytest.mark.slow
def test_the_validity_heads_graph_answers_as_the_network():
    head = make_head(ValidityConfig(hidden=8), PlanarWorld(TWO_LINK, Camera()))

    def confidence(image, configurations):
        return torch.sigmoid(head(image, configurations.unsqueeze(0))).squeeze(0)

    feeds = [{"image": pictures(), "configurations": torch.rand(count, 2) * 6.0 - 3.0} for count in (1, 33)]
    check(validity_graph(head, 48, 2), confidence, *feeds)


@pytest.mark.slow
def test_the_novelty_graph_answers_as_the_network():
    scores = NoveltyScores(Decoder((3, 48, 48), 6, 4), (3, 48, 48)).eval()
    feeds = {"image": pictures(), "mu": torch.randn(1, 6)}
    check(novelty_graph(scores, 48, 6), lambda image, mu: scores(image, mu)[0], feeds)


def test_a_blot_raises_the_worst_parts_error_more_than_the_whole_pictures():
    decoder = Decoder((3, 48, 48), 6, 4).eval()
    scores, mu = NoveltyScores(decoder, (3, 48, 48)).eval(), torch.randn(1, 6)
    with torch.no_grad():
        drawn = decoder(mu)
        blotted = drawn.clone()
        blotted[:, :, 12:18, 12:18] += 1.0
        assert scores(drawn, mu).abs().max() < 1e-9
        whole, worst = scores(blotted, mu)[0].tolist()
    assert worst == pytest.approx(1.0)
    assert whole == pytest.approx(36 / 48**2)
