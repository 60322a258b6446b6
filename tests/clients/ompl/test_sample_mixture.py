import numpy as np
import pytest

from cspace.worlds.planar.arm import TWO_LINK
from cspace_client.ompl import SampleMixture

GOAL = [9.0, 9.0]
SAMPLES = np.stack([np.linspace(-1.0, 1.0, 500), np.full(500, 0.25)], axis=-1)


def mixture(goal_bias=0.05, uniform_share=0.3, samples=SAMPLES, space=TWO_LINK.space):
    return SampleMixture(space, GOAL, samples, goal_bias, uniform_share, np.random.default_rng(0))


def test_after_the_last_learned_sample_all_are_uniform():
    draws = mixture(goal_bias=0.0, uniform_share=0.0, samples=SAMPLES[:3])
    drawn = np.array([draws.draw() for _ in range(2003)])[3:]
    assert (draws.learned_drawn, draws.uniform_drawn) == (3, 2000)
    quarters = np.histogram2d(*drawn.T, bins=2, range=[[-np.pi, np.pi]] * 2)[0]
    # Four standard deviations of a binomial count.
    assert np.all(np.abs(quarters - 500) < 4 * np.sqrt(2000 * 0.25 * 0.75))


def test_shares_are_those_that_were_asked_for():
    draws = mixture(goal_bias=0.1, uniform_share=0.3, samples=np.zeros((20_000, 2)))
    for _ in range(10_000):
        draws.draw()
    assert draws.goal_drawn == pytest.approx(1000, abs=120)
    assert draws.uniform_drawn == pytest.approx(2700, abs=180)
    assert draws.goal_drawn + draws.uniform_drawn + draws.learned_drawn == 10_000
