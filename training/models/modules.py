"""The Lightning shells: what one training step does, and nothing of clusters, trackers or files."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import lightning
import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR, OneCycleLR

from training.models.data import Held

Metrics = dict[str, float]


def mlp(inputs: int, hidden: int, layers: int, outputs: int) -> nn.Sequential:
    """A plain perceptron with ``layers`` hidden layers."""
    sizes = [inputs] + [hidden] * layers
    blocks: list[nn.Module] = []
    for before, after in pairwise(sizes):
        blocks += [nn.Linear(before, after), nn.LeakyReLU(0.2)]
    return nn.Sequential(*blocks, nn.Linear(sizes[-1], outputs))


def near_zero(last: nn.Module) -> None:
    """Let a perceptron's last layer start near zero."""
    assert isinstance(last, nn.Linear)  # noqa: S101 - for the type checker
    nn.init.normal_(last.weight, std=1e-2)
    nn.init.zeros_(last.bias)


class TrialModule(lightning.LightningModule):
    """What the trials need of every model: a random stream of its own, data, optimisers, the last metrics."""

    samples: Held | None = None

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.automatic_optimization = False
        self.seed = seed
        self.latest: dict[str, Tensor] = {}
        self.training_optimisers: list[Optimizer] = []
        self.training_schedules: list[LambdaLR | OneCycleLR] = []
        self._rng: torch.Generator | None = None
        self._rng_state: Tensor | None = None

    @property
    def rng(self) -> torch.Generator:
        """The generator of every random draw in training, on the module's device."""
        if self._rng is None or self._rng.device != self.device:
            self._rng = torch.Generator(device=self.device).manual_seed(self.seed)
            if self._rng_state is not None:
                self._rng.set_state(self._rng_state)
        return self._rng

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the state of the random stream."""
        checkpoint["rng"] = self.rng.get_state()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Take the random stream up when the module is on its device."""
        self._rng, self._rng_state = None, checkpoint["rng"].cpu()

    def on_fit_start(self) -> None:
        """Keep the data where the model is."""
        if self.samples is not None:
            self.samples = self.samples.to(self.device)

    def configure_optimizers(self) -> tuple[list[Optimizer], list[LambdaLR | OneCycleLR]]:
        """The optimisers and schedules made at construction."""
        return self.training_optimisers, self.training_schedules

    def metrics(self) -> Metrics:
        """Means of the last step's losses as plain numbers."""
        return {name: float(value) for name, value in self.latest.items()}

    def normal(self, *shape: int) -> Tensor:
        """Standard normal draws from the module's own generator."""
        return torch.randn(*shape, generator=self.rng, device=self.device)

    def uniform(self, *shape: int) -> Tensor:
        """Uniform draws in [0, 1) from the module's own generator."""
        return torch.rand(*shape, generator=self.rng, device=self.device)

    def one_cycle(self, parameters: Iterable[nn.Parameter], learning_rate: float, steps: int) -> None:
        """Train by Adam with a learning rate that rises once and falls."""
        optimiser = torch.optim.Adam(parameters, lr=learning_rate)
        self.training_optimisers = [optimiser]
        self.training_schedules = [OneCycleLR(optimiser, learning_rate, total_steps=steps + 1, pct_start=0.1)]

    def step_optimiser(self, index: int) -> None:
        """Step an optimiser as Lightning's, which counts it as the trainer's global step."""
        optimisers = self.optimizers()
        (optimisers if isinstance(optimisers, list) else [optimisers])[index].step()

    def descend(self, loss: Tensor, clip: float | None = None) -> None:
        """One step of the only optimiser and its schedule, the gradient's norm clipped where asked."""
        differentiate(loss, self.training_optimisers[0])
        if clip is not None:
            nn.utils.clip_grad_norm_(self.parameters(), clip)
        self.step_optimiser(0)
        self.training_schedules[0].step()


def differentiate(loss: Tensor, optimiser: Optimizer) -> None:
    """Fill the gradients of an optimiser's parameters."""
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
