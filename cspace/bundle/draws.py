"""What is random in a request, drawn from one generator in one fixed order.

The order is part of the bundle's contract, for it decides what a seed means:

1. ``rng = Generator(PCG64(SeedSequence(seed)))``; for a further turn, which draws what the ones before left
   missing or put outside the robot's limits, ``SeedSequence(seed, spawn_key=(turn,))`` with turn = 1, 2, ...
2. eta, standard normal float32 (m, L), for all m latents of the request at once.
3. Every random input of the description in its order there, float32 (m, *shape), for all latents at once:
   standard normal, or low + (high - low) * u with u uniform in [0, 1).

The latents of the first value of the epsilon schedule come first, then those of the second, and so on; each
value gets ceil(share / K) of them, and the last one's surplus samples are left out. How a request that
filters comes by its shares is told in :mod:`cspace.bundle.keeping`; of what it draws, the description's
``uniform_share`` is uniform over the joint space instead of generated, by a generator of its own:
``SeedSequence(seed, spawn_key=(turn, 1))``, first u uniform in [0, 1) for every sample, uniform where
u < share, then d angles for each of these. With a share of 1 there is no u, and nothing of 2 and 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.parts import RandomInput
from cspace.bundle.spec import BundleSpec


@dataclass(frozen=True, slots=True)
class Draws:
    """The random part of one request.

    Args:
        latents: z = mu + (sigma + epsilon) * eta, float32 (m, L).
        random_inputs: name to float32 (m, *shape).
        kept: bool (m, K), which samples of each latent belong to the answer.
    """

    latents: NDArray[np.float32]
    random_inputs: dict[str, NDArray[np.float32]]
    kept: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """Which samples of a turn are uniform, and these.

    Args:
        learned: how many the generator has to draw for each value of the schedule.
        uniform: bool (m,), the samples in their order.
        angles: float32 (u, d) rad, the uniform ones.
    """

    learned: list[int]
    uniform: NDArray[np.bool_]
    angles: NDArray[np.float32]

    def mixed_with(self, learned: NDArray[np.float32] | None) -> NDArray[np.float32]:
        """All samples (m, d) in their order, from (m - u, d) generated ones; None for none."""
        if learned is None and len(self.angles) == len(self.uniform):
            return self.angles
        mixed = np.empty((len(self.uniform), self.angles.shape[1]), dtype=np.float32)
        mixed[self.uniform] = self.angles
        if learned is not None:
            mixed[~self.uniform] = learned
        return mixed


def propose(spec: BundleSpec, counts: Sequence[int], seed: int, turn: int) -> Proposals:
    """The uniform samples of one turn of a request that filters.

    Args:
        spec: the share and the joint space.
        counts: samples for each value of the schedule.
        seed: unsigned 64 bit.
        turn: 0 for the first.
    """
    total, space = sum(counts), spec.world.space
    if spec.uniform_share == 0.0:
        nothing = np.empty((0, spec.dim), dtype=np.float32)
        return Proposals(list(counts), np.zeros(total, dtype=np.bool_), nothing)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(turn, 1))))
    if spec.uniform_share == 1.0:
        angles = space.to_float32(space.sample_uniform(rng, total))
        return Proposals([0] * len(counts), np.ones(total, dtype=np.bool_), angles)
    uniform = rng.random(total) < spec.uniform_share
    angles = space.to_float32(space.sample_uniform(rng, int(uniform.sum())))
    by_value = np.split(uniform, np.cumsum(counts)[:-1])
    return Proposals([len(part) - int(part.sum()) for part in by_value], uniform, angles)


def shares(count: int, parts: int) -> list[int]:
    """``count`` split into equal parts, the remainder to the first."""
    share = count // parts
    return [share + count % parts, *[share] * (parts - 1)]


def draw(
    spec: BundleSpec,
    mu: NDArray[np.float32],
    sigma: NDArray[np.float32],
    counts: Sequence[int],
    seed: int,
    epsilon_sigma: Sequence[float],
    turn: int = 0,
) -> Draws:
    """Everything random in one turn of a request.

    Args:
        spec: names, shapes and distributions.
        mu: (L,) the encoder's mean.
        sigma: (L,) its standard deviation.
        counts: samples for each value of ``epsilon_sigma``.
        seed: unsigned 64 bit.
        epsilon_sigma: what sigma is raised by, one or more values.
        turn: 0 for the first.
    """
    per_latent = spec.samples_per_latent
    epsilons: list[NDArray[np.float32]] = []
    kept: list[NDArray[np.bool_]] = []
    for epsilon, share in zip(epsilon_sigma, counts, strict=True):
        latents = -(-share // per_latent)
        epsilons.append(np.full(latents, epsilon, dtype=np.float32))
        kept.append((np.arange(latents * per_latent) < share).reshape(latents, per_latent))
    deviation = sigma + np.concatenate(epsilons)[:, None]
    source = np.random.SeedSequence(seed, spawn_key=(turn,) if turn else ())
    rng = np.random.Generator(np.random.PCG64(source))
    eta = rng.standard_normal(deviation.shape, dtype=np.float32)
    inputs = {item.name: _draw_input(rng, item, len(eta)) for item in spec.random_inputs}
    return Draws(mu + deviation * eta, inputs, np.concatenate(kept))


def _draw_input(rng: np.random.Generator, item: RandomInput, count: int) -> NDArray[np.float32]:
    shape = (count, *item.shape)
    if item.low is None or item.high is None:
        return rng.standard_normal(shape, dtype=np.float32)
    low, high = np.float32(item.low), np.float32(item.high)
    return low + (high - low) * rng.random(shape, dtype=np.float32)
