"""The clusters' generators behind a gate: cells of the configuration space, drawn by the picture."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from cspace.bundle import RandomInput
from cspace.errors import ConfigError
from cspace.space import JointSpace
from training.config import TrainConfig, TrialSettings
from training.models.checkpoint import trained
from training.models.data import Cells
from training.models.export import Sampler
from training.models.families import Checkpoints, Trial, register
from training.models.families.guided import local_names
from training.models.families.wgan_gp import (
    GanConfig,
    TorusGenerator,
    UniformBase,
    WganGp,
    WganGpModule,
    beside,
)
from training.models.lookups import ArmLookups, LookupConfig, look, make_lookups, make_reader
from training.models.modules import TrialModule, mlp

GATE = "gate"


class GateConfig(TrialSettings):
    """The gate: which cell of the configuration space a picture's free configurations lie in."""

    cells: int = Field(32, ge=1, description="that clusters are made of")
    points: int = Field(1024, ge=1, description="stored in each cell, from which the generators start")
    steps: int = Field(600, ge=1, description="optimiser steps")
    batch_size: int = Field(128, ge=1, description="scenarios a step")
    hidden: int = Field(128, ge=1, description="units of a layer")
    layers: int = Field(2, ge=1, description="hidden layers")
    learning_rate: float = Field(4e-3, gt=0, description="highest of the one-cycle schedule")


class LocalConfig(GanConfig):
    """One cluster's WGAN-GP, which may read the picture where the arm would be."""

    generator_lookups: LookupConfig = LookupConfig()
    critic_lookups: LookupConfig = LookupConfig()


class MixtureConfig(TrainConfig):
    """Everything that fixes a job that trains a generator a cluster behind a gate."""

    gate: GateConfig = GateConfig()
    local: LocalConfig = LocalConfig(steps=400)

    @property
    def reads_pictures(self) -> bool:
        """Whether generators or critics look pictures up."""
        local = self.local
        return bool(local.generator_lookups.points_per_link or local.critic_lookups.points_per_link)

    @property
    def cells(self) -> int:
        """Into how many cells the configuration space is divided."""
        return self.gate.cells

    @property
    def cell_points(self) -> int:
        """How many configurations are stored in each cell."""
        return self.gate.points

    @model_validator(mode="after")
    def _cells_fit(self) -> "MixtureConfig":
        if self.gate.cells < self.clusters.count:
            raise ValueError(
                f"clusters.form=mixture needs gate.cells of at least clusters.count, {self.clusters.count}"
            )
        if self.local.generator == "means":
            raise ValueError("a gate needs generator=torus: the means have no base to draw in a cell")
        for part in ("generator_lookups", "critic_lookups"):
            lookups: LookupConfig = getattr(self.local, part)
            if self.known_world is None or not lookups.points_per_link:
                continue
            try:
                self.known_world.link_sample_points(lookups.points_per_link, lookups.side_m)
            except ConfigError as error:
                text = f"local.{part}.points_per_link does not fit the robot: {error}"
                raise ValueError(text) from error
        return self


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


class CellBase(UniformBase):
    """A torus generator starts evenly inside cells that are drawn by their probability under the scenario.

    ``probabilities`` (S, k) float32, not negative; a row need not sum to one.
    """

    points: Tensor
    spacing: Tensor
    probabilities: Tensor

    def __init__(self, cells: Cells, probabilities: Tensor, space: JointSpace) -> None:
        super().__init__(space)
        self.register_buffer("points", torch.tensor(cells.points), persistent=False)
        self.register_buffer("spacing", torch.tensor(cells.spacing_rad), persistent=False)
        self.register_buffer("probabilities", probabilities, persistent=False)

    def draw(self, ids: Tensor, rng: torch.Generator) -> Tensor:
        """(b, d) rad for scenarios (b,)."""
        count, device = len(ids), ids.device
        cell = torch.multinomial(self.probabilities[ids], 1, generator=rng).squeeze(1)
        place = torch.randint(self.points.shape[1], (count,), generator=rng, device=device)
        jitter = torch.rand(count, self.points.shape[2], generator=rng, device=device) - 0.5
        return self.joints.fold(self.points[cell, place] + self.spacing[cell].unsqueeze(1) * jitter)


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
        inputs = beside([latent, self.joints.features(base), noise], seen)
        if len(self.networks) == 1:
            return self.joints.fold(base + self.networks[0](inputs))
        # Each generator answers for its own rows; these stand behind each other until they are put back.
        chosen = self.clusters[cell]
        rows = [torch.nonzero(chosen == index).squeeze(1) for index in range(len(self.networks))]
        steps = torch.cat([net(inputs[own]) for net, own in zip(self.networks, rows, strict=True)])
        where = torch.cat(rows).unsqueeze(1).expand(-1, base.shape[1])
        return self.joints.fold(base + torch.zeros_like(base).scatter(0, where, steps))


class GatedSampler(Sampler):
    """The whole sampler as one graph whose randomness is an input.

    Shapes: latent (m, L), cell and place (m, 1) in [0, 1), jitter (m, d) in [-1/2, 1/2), noise (m, n), and
    with look-ups image (1, 3, P, P), to (m, 1, d) rad.
    """

    points: Tensor
    spacing: Tensor

    def __init__(self, gate: Gate, cells: Cells, experts: Experts, lookups: ArmLookups | None) -> None:
        super().__init__()
        self.gate, self.experts, self.lookups = gate, experts, lookups
        self.looks_at_picture = lookups is not None
        self.random_inputs = (
            RandomInput("cell", "uniform", (1,), 0.0, 1.0),
            RandomInput("place", "uniform", (1,), 0.0, 1.0),
            RandomInput("jitter", "uniform", (experts.joints.dim,), -0.5, 0.5),
            RandomInput("noise", "normal", (experts.noise_dim,)),
        )
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
        samples: Tensor = self.experts(latent, base, noise, look(self.lookups, image, base), chosen)
        return samples.unsqueeze(1)


# Keeps a row of probabilities from vanishing where the gate gives a scenario none of a cluster's cells.
_LEAST_PROBABILITY = 1e-8


@register("mixture")
class Mixture(WganGp):
    """The gate, then a WGAN-GP a cluster whose generators are what is served."""

    configuration = MixtureConfig
    model_kind = "mixture"

    def stages(self) -> Mapping[str, Sequence[str]]:
        """The gate before the clusters, which train side by side."""
        return {GATE: [GATE], "local": local_names(self.config.clusters.count)}

    def trial(self, name: str, seed: int, done: Checkpoints) -> Trial:
        """The gate, or one cluster's WGAN-GP (Algorithm 2)."""
        arrays = self.arrays
        if name == GATE:
            mu, sigma = torch.tensor(arrays.mu), torch.tensor(arrays.sigma)
            return Trial(GateModule(self.config.gate, mu, sigma, self._shares(), seed), self.config.gate)
        cluster = int(name.removeprefix("local-"))
        # It starts in the cells of its cluster, as the gate draws them.
        probabilities = gate_probabilities(self.load_gate(done[GATE]), arrays.mu) + _LEAST_PROBABILITY
        weights = torch.tensor((probabilities * (self.cells.clusters == cluster)).astype(np.float32))
        base = CellBase(self.cells, weights, arrays.world.space)
        module = WganGpModule(self.config.local, *self.given(cluster, seed, base))
        return Trial(module, self.config.local, arrays.part(cluster))

    def given(self, cluster: int | None, seed: int, base: UniformBase | None = None) -> tuple[Any, ...]:
        """With what reads the pictures."""
        scenes, local = self.arrays.scenes(), self.config.local
        readers = tuple(make_reader(one, scenes) for one in (local.generator_lookups, local.critic_lookups))
        return (*super().given(cluster, seed, base), readers)

    @property
    def cells(self) -> Cells:
        """The cells of the gate."""
        assert self.arrays.cells is not None  # noqa: S101 - for the type checker
        return self.arrays.cells

    def load_gate(self, checkpoint: Path) -> Gate:
        """The gate of a trial's checkpoint."""
        gate = self.config.gate
        sizes = (self.config.vae.latent_dim, gate.hidden, gate.layers, gate.cells)
        return trained(lambda: Gate(*sizes), checkpoint, GATE)

    def sampler(self, done: Checkpoints) -> Sampler:
        """All clusters' generators behind the gate."""
        config = self.config.local
        names = local_names(self.config.clusters.count)
        generators = [self.load(config, done[name], "generator") for name in names]
        experts = Experts(generators, torch.tensor(self.cells.clusters))
        lookups = make_lookups(config.generator_lookups, self.arrays.world)
        return GatedSampler(self.load_gate(done[GATE]), self.cells, experts, lookups).eval()

    def _shares(self) -> Tensor:
        """Share of every scenario's configurations in each cell, (S, k) float32."""
        counts = np.zeros((len(self.arrays.mu), len(self.cells.clusters)), dtype=np.float32)
        np.add.at(counts, (self.arrays.ids, self.cells.labels), 1.0)
        return torch.tensor(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0))
