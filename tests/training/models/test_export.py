from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.space import circles
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.models.autoencoders import NoveltyScores
from training.models.export import encoder_graph, generator_graph, novelty_graph, validity_graph
from training.models.networks import Decoder, Encoder, MeansGenerator, Sizes, TorusGenerator
from training.models.settings import ValidityConfig
from training.models.validity import make_head


def answer(graph, feeds):
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    return session.run(None, {name: value.numpy() for name, value in feeds.items()})


@pytest.mark.parametrize("count", [1, 5])
def test_the_encoders_graph_answers_as_the_network_for_any_number_of_pictures(count):
    encoder = Encoder(48, 6, 4, 4)
    images = torch.rand(count, 3, 48, 48) * 2.0 - 1.0
    with torch.no_grad():
        mu, log_variance = encoder(images)
    graph_mu, graph_sigma = answer(encoder_graph(encoder, 48), {"image": images})
    np.testing.assert_allclose(graph_mu, mu.numpy(), atol=1e-5)
    np.testing.assert_allclose(graph_sigma, (log_variance / 2.0).exp().numpy(), rtol=1e-5)


@pytest.mark.parametrize("count", [1, 33])
def test_the_torus_generators_graph_answers_as_the_network(count):
    generator = TorusGenerator(Sizes(circles(3), 6, 16, 2), 2)
    feeds = {"latent": torch.randn(count, 6), "base": torch.randn(count, 3), "noise": torch.randn(count, 2)}
    with torch.no_grad():
        expected = generator(*feeds.values())
    (samples,) = answer(generator_graph(generator, 3, 6, 2), feeds)
    np.testing.assert_allclose(samples, expected.numpy(), atol=1e-5)


def test_the_means_generators_graph_answers_as_the_network():
    generator = MeansGenerator(Sizes(circles(2), 6, 16, 2), 4, 0.1, (torch.zeros(2), torch.ones(2)))
    feeds = {"latent": torch.randn(9, 6), "noise": torch.randn(9, 4, 2)}
    with torch.no_grad():
        expected = generator(*feeds.values())
    (samples,) = answer(generator_graph(generator, 2, 6, 1), feeds)
    np.testing.assert_allclose(samples, expected.numpy(), atol=1e-5)


def test_graphs_name_no_folder_of_the_machine_that_exported_them():
    encoder, generator = Encoder(48, 6, 4, 4), TorusGenerator(Sizes(circles(2), 6, 16, 2), 2)
    for graph in (encoder_graph(encoder, 48), generator_graph(generator, 2, 6, 2)):
        assert b".py" not in graph
        assert str(Path(torch.__file__).parent).encode() not in graph


@pytest.mark.parametrize("count", [1, 33])
def test_the_validity_heads_graph_answers_as_the_network(count):
    head = make_head(ValidityConfig(free_share=0.69, hidden=8), PlanarWorld(TWO_LINK, Camera()))
    image, configurations = torch.rand(1, 3, 48, 48) * 2.0 - 1.0, torch.rand(count, 2) * 6.0 - 3.0
    with torch.no_grad():
        expected = torch.sigmoid(head(image, configurations.unsqueeze(0))).squeeze(0)
    (confidence,) = answer(validity_graph(head, 48, 2), {"image": image, "configurations": configurations})
    np.testing.assert_allclose(confidence, expected.numpy(), atol=1e-5)


def test_the_novelty_graph_answers_as_the_network():
    scores = NoveltyScores(Decoder(48, 6, 4), 48).eval()
    image, mu = torch.rand(1, 3, 48, 48) * 2.0 - 1.0, torch.randn(1, 6)
    with torch.no_grad():
        expected = scores(image, mu)[0]
    (found,) = answer(novelty_graph(scores, 48, 6), {"image": image, "mu": mu})
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-5)


def test_a_blot_raises_the_worst_parts_error_more_than_the_whole_pictures():
    decoder = Decoder(48, 6, 4).eval()
    scores, mu = NoveltyScores(decoder, 48).eval(), torch.randn(1, 6)
    with torch.no_grad():
        drawn = decoder(mu)
        blotted = drawn.clone()
        blotted[:, :, 12:18, 12:18] += 1.0
        assert scores(drawn, mu).abs().max() < 1e-9
        whole, worst = scores(blotted, mu)[0].tolist()
    assert worst == pytest.approx(1.0)
    assert whole == pytest.approx(36 / 48**2)
