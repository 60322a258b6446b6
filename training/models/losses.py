"""Losses of WGAN-GP and VAE as pure functions.

After J. Ocampo Jimenez and W. Suleiman, "Improving Path Planning Performance through Multimodal Generative
Models with Local Critics"; Gulrajani et al. 2017 for the penalty. Deviations, each of which mends a misprint,
are listed in docs/paper.md.
"""

from collections.abc import Callable

import torch
from torch import Tensor


def critic_loss(real: Tensor, fake: Tensor) -> Tensor:
    """f(fake) - f(real), the critic's part of the loss without its penalty (eq. wgangp, signs mended).

    Args:
        real: (b,) critic values of real configurations.
        fake: (b,) or (b, K) critic values of generated ones.
    """
    return fake.mean() - real.mean()


def generator_loss(fake: Tensor) -> Tensor:
    """-f(fake), averaged over everything generated (Algorithm 1, line 11)."""
    return -fake.mean()


def guided_generator_loss(fake: Tensor, local: list[Tensor], weight: float) -> Tensor:
    """The global generator's loss: its own critic plus the mean of the local ones (eq. multiDirector).

    ``fake`` (b, K) values of the global critic.
    """
    loss = generator_loss(fake)
    if local and weight > 0.0:
        loss = loss + weight * torch.stack([generator_loss(values) for values in local]).mean()
    return loss


def wrapped_interpolation(real: Tensor, fake: Tensor, share: Tensor) -> Tensor:
    """Points on the shortest way round from ``fake`` to ``real`` (eq. gangp on the torus).

    Args:
        real: (b, d) rad.
        fake: (b, d) rad.
        share: (b, 1) in [0, 1].
    """
    difference = torch.remainder(real - fake + torch.pi, 2.0 * torch.pi) - torch.pi
    return fake + share * difference


def straight_interpolation(real: Tensor, fake: Tensor, share: Tensor) -> Tensor:
    """Points on the straight segment from ``fake`` to ``real`` (eq. gangp)."""
    return fake + share * (real - fake)


def gradient_penalty(critic: Callable[[Tensor], Tensor], points: Tensor, *, one_sided: bool) -> Tensor:
    """E[(|grad f| - 1)^2], or only where the norm is above 1 when one-sided (eq. wgangp).

    The two-sided form oscillates in two dimensions; the one-sided form bounds the slope and no more.

    ``points`` (b, d), interpolated.
    """
    points = points.detach().requires_grad_()
    (gradient,) = torch.autograd.grad(critic(points).sum(), points, create_graph=True)
    # The small constant keeps the derivative of the root finite at a zero gradient.
    excess = (gradient.square().sum(dim=-1) + 1e-12).sqrt() - 1.0
    if one_sided:
        excess = torch.relu(excess)
    return excess.square().mean()


def smooth_maximum(first: Tensor, second: Tensor, epsilon: float) -> Tensor:
    """(x1 + x2 + sqrt((x1 - x2)^2 + eps^2)) / 2, which tends to the maximum as eps tends to 0."""
    return (first + second + ((first - second).square() + epsilon**2).sqrt()) / 2.0


def nested_smooth_maximum(values: Tensor, epsilon: float) -> Tensor:
    """Smooth maximum over the last axis, pair by pair: (b, K) to (b,)."""
    result = values[..., 0]
    for index in range(1, values.shape[-1]):
        result = smooth_maximum(result, values[..., index], epsilon)
    return result


def fake_term(values: Tensor, epsilon: float | None) -> Tensor:
    """The critic's value of K generated samples: their mean, or (mean + smooth maximum) / 2.

    Half of each keeps the loss invariant to a constant added to f; the printed sum lets f drift away.

    ``values`` (b, K) critic values.
    """
    mean = values.mean(dim=-1)
    if epsilon is None or values.shape[-1] == 1:
        return mean
    return (mean + nested_smooth_maximum(values, epsilon)) / 2.0


def kl_divergence(mu: Tensor, log_variance: Tensor) -> Tensor:
    """KL(N(mu, s^2) | N(0, 1)) = sum(mu^2 + s^2 - log s^2 - 1) / 2 over the latent, (b,) (eq. kl, mended)."""
    return 0.5 * (mu.square() + log_variance.exp() - log_variance - 1.0).sum(dim=-1)


def reconstruction_loss(images: Tensor, decoded: Tensor) -> Tensor:
    """Squared error summed over each picture, (b,)."""
    return (images - decoded).square().flatten(1).sum(dim=-1)
