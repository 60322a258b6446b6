import numpy as np
import pytest
import torch

from cspace.space import JointSpace, circles
from tests.bundles import holds
from training.models.families.wgan_gp import MeansGenerator, Sizes, TorusGenerator, UniformBase
from training.models.joints import Joints

TORUS = Joints(circles(3))
# A circle between two joints with limits, one of them beyond half a turn and one wider than a turn.
SPACE = JointSpace((-2.9, -np.pi, -7.0), (4.0, np.pi, 1.0), (False, True, False))
MIXED = Joints(SPACE)
RNG = torch.Generator().manual_seed(0)


def angles(count=500, scale=20.0):
    return scale * (2.0 * torch.rand(count, 3, generator=RNG) - 1.0)


def test_folding_keeps_what_is_inside_and_mirrors_the_rest_at_the_limits():
    inside = torch.tensor(SPACE.sample_uniform(np.random.default_rng(0), 300), dtype=torch.float32)
    torch.testing.assert_close(MIXED.fold(inside), inside, rtol=0, atol=2e-6)
    outside = torch.tensor([[4.5, 9.0, 1.25], [-3.0, -9.0, -7.5], [4.0 + 6.9 + 0.1, 0.0, -7.0]])
    folded = torch.tensor([[3.5, 9.0, 0.75], [-2.8, -9.0, -6.5], [-2.8, 0.0, -7.0]])
    torch.testing.assert_close(MIXED.fold(outside), folded, rtol=0, atol=1e-5)
    assert holds(SPACE, SPACE.to_float32(MIXED.fold(angles(5000)).numpy()))


def test_what_is_uniform_on_the_torus_becomes_uniform_within_the_limits():
    drawn = UniformBase(SPACE).draw(torch.zeros(40_000, dtype=torch.int64), RNG)
    low, high = drawn.min(dim=0).values.numpy(), drawn.max(dim=0).values.numpy()
    np.testing.assert_allclose(low, SPACE.lower, atol=0.01)
    np.testing.assert_allclose(high, SPACE.upper, atol=0.01)
    np.testing.assert_allclose(drawn.std(dim=0), np.subtract(SPACE.upper, SPACE.lower) / 12**0.5, rtol=0.02)


def test_ways_go_round_circles_alone():
    start, end = torch.tensor([[-2.8, 3.0, -6.0]]), torch.tensor([[3.9, -3.0, 0.5]])
    way = torch.tensor([[6.7, 2.0 * np.pi - 6.0, 6.5]])
    torch.testing.assert_close(MIXED.difference(start, end), way)
    half = torch.tensor([[0.5]])
    torch.testing.assert_close(MIXED.interpolate(start, end, half), start + way / 2.0)


def test_embedding_and_back_is_the_same_configuration():
    inside = torch.tensor(SPACE.sample_uniform(np.random.default_rng(1), 300), dtype=torch.float32)
    circle, limited = inside[:, 1:2], [0, 2]
    low, high = (torch.tensor(ends, dtype=torch.float32)[limited] for ends in (SPACE.lower, SPACE.upper))
    places = 2.0 * (inside[:, limited] - low) / (high - low) - 1.0
    embedded = torch.cat([torch.cos(circle), torch.sin(circle), places], dim=1)
    assert embedded.shape == (300, MIXED.embedded_size)
    torch.testing.assert_close(MIXED.unembed(embedded), inside, rtol=0, atol=1e-5)


def test_features_tell_turns_of_a_limited_joint_apart_and_not_those_of_a_circle():
    at = torch.tensor([[0.5, 0.5, -6.0]])
    for joint, same in ((1, True), (2, False)):
        turned = at.clone()
        turned[0, joint] += 2.0 * torch.pi
        assert torch.allclose(MIXED.features(at), MIXED.features(turned), atol=1e-5) == same
    assert MIXED.features(at).shape == (1, MIXED.features_size)
    assert MIXED.pair_features(at).shape == (1, MIXED.pair_features_size)


@pytest.mark.parametrize("means", [False, True])
def test_no_generator_leaves_the_limits(means):
    if means:
        scale = (torch.zeros(3), torch.full((3,), 9.0))
        samples = MeansGenerator(Sizes(SPACE, 4, 8, 2), 5, 1.0, scale)(
            torch.randn(200, 4), torch.randn(200, 5, 3)
        )
    else:
        generator = TorusGenerator(Sizes(SPACE, 4, 8, 2), 2)
        torch.nn.init.normal_(generator.residual[-1].weight, std=20.0)
        samples = generator(torch.randn(1000, 4), angles(1000, 3.0), torch.randn(1000, 2))
    values = samples.detach().reshape(-1, 3).numpy()
    limited = ~np.asarray(SPACE.periodic)
    assert (values >= np.float32(SPACE.lower) - 1e-5)[:, limited].all()
    assert (values <= np.float32(SPACE.upper) + 1e-5)[:, limited].all()
    assert np.ptp(values[:, 0]) > 5.0
