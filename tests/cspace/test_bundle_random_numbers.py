import numpy as np

from cspace.bundle.sampling import random_numbers, uniform_proposals
from tests.bundles import LATENT, tiny_spec


def test_draws_follow_the_documented_order() -> None:
    spec = tiny_spec()
    mu, sigma = np.arange(LATENT, dtype=np.float32), np.full(LATENT, 0.5, dtype=np.float32)
    draws = random_numbers(spec, mu, sigma, (3, 2), 11, (0.0, 2.0))
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(11)))
    eta = rng.standard_normal((5, LATENT), dtype=np.float32)
    raised = np.array([0.5, 0.5, 0.5, 2.5, 2.5], dtype=np.float32)[:, None]
    np.testing.assert_array_equal(draws.latents, mu + raised * eta)
    low, high = np.float32(-np.pi), np.float32(np.pi)
    base = low + (high - low) * rng.random((5, 2), dtype=np.float32)
    np.testing.assert_array_equal(draws.random_inputs["base"], base)
    np.testing.assert_array_equal(draws.random_inputs["noise"], rng.standard_normal((5, 2), dtype=np.float32))


def test_uniform_proposals_lie_among_the_others_in_their_order() -> None:
    spec = tiny_spec()
    uniform, angles = uniform_proposals(spec, (300, 100), 7, 0)
    assert len(angles) == uniform.sum()
    assert 0.18 < uniform.mean() < 0.32
    assert np.abs(angles).max() < np.pi
    assert not np.array_equal(uniform_proposals(spec, (300, 100), 7, 1)[0], uniform)
