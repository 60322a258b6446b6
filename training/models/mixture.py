"""The gated mixture of the clusters' generators: gate and sampler."""

from collections.abc import Sequence
from copy import deepcopy

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from training.models.cells import CellPoints
from training.models.lookups import ArmLookups
from training.models.modules import TrialModule
from training.models.networks import TorusGenerator, generator_inputs, mlp
from training.models.settings import GateConfig


class Gate(nn.Module):
    """p(cell | picture) from the latent.

    Shapes: latent (m, L) to logits (m, k).
    """

    def __init__(self, latent_dim: int, hidden: int, layers: int, cells: int) -> None:
        super().__init__()
        self.net = mlp(latent_dim, hidden, layers, cells)

    def forward(self, latent: Tensor) -> Tensor:
        """The logits."""
        logits: Tensor = self.net(latent)
        return logits


class GateModule(TrialModule):
    """Trains the gate by cross entropy on each cell's share of a scenario's free configurations.

    ``mu`` (S, L) latent means; ``sigma`` (S, L) latent standard deviations; ``shares`` (S, k) of every
    scenario's free configurations in each cell.
    """

    mu: Tensor
    sigma: Tensor
    shares: Tensor

    def __init__(self, config: GateConfig, mu: Tensor, sigma: Tensor, shares: Tensor, seed: int) -> None:
        super().__init__(seed)
        self.config = config
        for name, value in (("mu", mu), ("sigma", sigma), ("shares", shares)):
            self.register_buffer(name, value, persistent=False)
        self.gate = Gate(mu.shape[1], config.hidden, config.layers, config.cells)
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of the cross entropy."""
        del step, batch_index
        rows = torch.randint(len(self.mu), (self.config.batch_size,), generator=self.rng, device=self.device)
        mu, shares = self.mu[rows], self.shares[rows]
        log_gate = functional.log_softmax(self.gate(mu + self.sigma[rows] * self.normal(*mu.shape)), dim=1)
        loss = -(shares * log_gate).sum(dim=1).mean()
        self.descend(loss)
        entropy = -torch.xlogy(shares, shares).sum(dim=1).mean()
        self.latest = {"gate_loss": loss.detach(), "gate_divergence": loss.detach() - entropy}


def gate_probabilities(gate: Gate, mu: NDArray[np.float32]) -> NDArray[np.float32]:
    """p(cell | picture) for (S, L) latent means, (S, k)."""
    gate.eval()
    with torch.inference_mode():
        probabilities: NDArray[np.float32] = functional.softmax(gate(torch.tensor(mu)), dim=1).numpy()
    return probabilities


class Experts(nn.Module):
    """Torus generators of one shape, each in charge of some cells.

    ``clusters`` (k,) the generator that is in charge of each cell. Shapes: latent (m, L), base (m, d) rad,
    noise (m, n), seen (m, looked_up) or None, cell (m,) to (m, d).
    """

    clusters: Tensor

    def __init__(self, generators: Sequence[TorusGenerator], clusters: Tensor) -> None:
        super().__init__()
        self.noise_dim, self.joints = generators[0].noise_dim, generators[0].joints
        self.register_buffer("clusters", clusters)
        self.networks = nn.ModuleList(deepcopy(generator.residual) for generator in generators)

    def forward(
        self, latent: Tensor, base: Tensor, noise: Tensor, seen: Tensor | None, cell: Tensor
    ) -> Tensor:
        """One configuration for each latent, by the generator in charge of its cell."""
        inputs = generator_inputs(self.joints, latent, base, noise, seen)
        if len(self.networks) == 1:
            return self.joints.fold(base + self.networks[0](inputs))
        # Each generator answers for its own rows; these stand behind each other until they are put back.
        chosen = self.clusters[cell]
        rows = [torch.nonzero(chosen == index).squeeze(1) for index in range(len(self.networks))]
        steps = torch.cat([net(inputs[own]) for net, own in zip(self.networks, rows, strict=True)])
        where = torch.cat(rows).unsqueeze(1).expand(-1, base.shape[1])
        return self.joints.fold(base + torch.zeros_like(base).scatter(0, where, steps))


class GatedSampler(nn.Module):
    """The whole sampler as one graph whose randomness is an input.

    Shapes: latent (m, L), cell and place (m, 1) in [0, 1), jitter (m, d) in [-1/2, 1/2), noise (m, n), and
    with look-ups image (1, 3, P, P), to (m, 1, d) rad.
    """

    points: Tensor
    spacing: Tensor

    def __init__(self, gate: Gate, cells: CellPoints, experts: Experts, lookups: ArmLookups | None) -> None:
        super().__init__()
        self.gate, self.experts, self.lookups = gate, experts, lookups
        self.noise_dim = experts.noise_dim
        self.register_buffer("points", torch.tensor(cells.points))
        self.register_buffer("spacing", torch.tensor(cells.spacing_rad))

    def forward(
        self,
        latent: Tensor,
        cell: Tensor,
        place: Tensor,
        jitter: Tensor,
        noise: Tensor,
        image: Tensor | None = None,
    ) -> Tensor:
        """One configuration for each latent."""
        count, size, dim = self.points.shape
        reached = torch.cumsum(functional.softmax(self.gate(latent), dim=1), dim=1)
        # Rounding may leave the last sum below one.
        chosen = (reached <= cell).float().sum(dim=1).long().clamp(max=count - 1)
        row = (place.squeeze(1) * size).long().clamp(max=size - 1)
        base = self.points.view(count * size, dim)[chosen * size + row]
        base = self.experts.joints.fold(base + self.spacing[chosen].unsqueeze(1) * jitter)
        seen = look(self.lookups, image, base)
        samples: Tensor = self.experts(latent, base, noise, seen, chosen)
        return samples.unsqueeze(1)


class LookupSampler(nn.Module):
    """A torus generator with look-ups and no gate, as one graph.

    Shapes: latent (m, L), base (m, d) rad, noise (m, n), image (1, 3, P, P) to (m, 1, d) rad.
    """

    def __init__(self, generator: TorusGenerator, lookups: ArmLookups) -> None:
        super().__init__()
        self.generator, self.lookups, self.noise_dim = generator, lookups, generator.noise_dim

    def forward(self, latent: Tensor, base: Tensor, noise: Tensor, image: Tensor) -> Tensor:
        """One configuration for each latent."""
        samples: Tensor = self.generator(latent, base, noise, look(self.lookups, image, base))
        return samples


def look(lookups: ArmLookups | None, image: Tensor | None, base: Tensor) -> Tensor | None:
    """What one picture (1, ...) shows at (m, d) configurations, (m, values); None without look-ups."""
    if lookups is None or image is None:
        return None
    seen: Tensor = lookups(image, base.unsqueeze(0))
    return seen.squeeze(0)
