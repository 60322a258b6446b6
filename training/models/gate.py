"""The gate: how much of a scenario's free space each cell of the configuration space holds."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from training.models.modules import TrialModule
from training.models.networks import mlp
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

    Args:
        config: sizes and budget.
        mu: (S, L) latent means.
        sigma: (S, L) latent standard deviations.
        shares: (S, k) of every scenario's free configurations in each cell.
        seed: of initialisation and of every draw.
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
