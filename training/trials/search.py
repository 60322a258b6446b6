"""The hyperparameter search: Tune's ASHA over settings of the generators, on validation scenarios."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import torch
from numpy.typing import NDArray
from ray import tune
from ray.tune.schedulers import ASHAScheduler
from ray.tune.search.basic_variant import BasicVariantGenerator
from torch import nn

from cspace.bundle import RandomInput
from cspace.errors import JobError
from cspace.simulator import Split, derived_seed
from cspace.world import World
from services.evaluator.scenes import Scene, Stage
from services.names import EXPERIMENT, TAG_STAGE
from services.registry.tracking import RunLog, Tracking
from training.config import ResourceConfig
from training.models.checkpoint import fit_module, seeded_initialisation
from training.models.data import TrainingArrays
from training.models.export import Sampler
from training.models.families.mixture import Gate, Mixture, MixtureConfig
from training.models.families.wgan_gp import GanConfig, WganGpModule
from training.trials.arrays import load_encoder

SAMPLES = 1000


@dataclass(frozen=True)
class Validation:
    """Validation scenarios with their truth, drawn once."""

    encoder: nn.Module
    scenes: Sequence[Scene]
    held_out: Sequence[NDArray[np.float64]]  # free configurations of each, (n, d) rad
    uniform_energy: float

    @classmethod
    def draw(cls, encoder: nn.Module, world: World, scenarios: int) -> "Validation":
        """The first scenarios of the validation split."""
        stage = Stage(world, Split.VALIDATION, 0)
        scenes = [Scene(stage, index) for index in range(scenarios)]
        held_out = [scene.free(SAMPLES, scene.rng(0)) for scene in scenes]
        stood = cls(encoder.eval(), scenes, held_out, 1.0)
        return replace(stood, uniform_energy=float(sum(row["energy"] for row in stood.rows(None))))

    def rows(self, sampler: Sampler | None) -> list[Mapping[str, float]]:
        """A sampler in every scenario; uniform samples for None."""
        return [
            scene.quality(self._sample(sampler, scene), real)
            for scene, real in zip(self.scenes, self.held_out, strict=True)
        ]

    def measure(self, sampler: Sampler) -> dict[str, float]:
        """Means of precision and coverage, and the energy ratio, as ``validation_*``."""
        rows = self.rows(sampler)
        return {
            "validation_precision": float(np.mean([row["precision"] for row in rows])),
            "validation_coverage": float(np.mean([row["coverage"] for row in rows])),
            "validation_edr": float(np.sum([row["energy"] for row in rows])) / self.uniform_energy,
        }

    def _sample(self, sampler: Sampler | None, scene: Scene) -> NDArray[np.float64]:
        if sampler is None:
            return scene.space.sample_uniform(scene.rng(1), SAMPLES)
        rng = torch.Generator().manual_seed(scene.sampler_seed())
        image = torch.from_numpy(scene.stage.world.sensor.to_network(scene.image[None]))
        with torch.inference_mode():
            mu, log_variance = self.encoder(image)
            latent = mu + (log_variance / 2.0).exp() * torch.randn(SAMPLES, mu.shape[1], generator=rng)
            drawn = [_drawn(one, rng) for one in sampler.random_inputs]
            seen = [image] if sampler.looks_at_picture else []
            samples: torch.Tensor = sampler(latent, *drawn, *seen)
        return scene.space.to_float32(samples.squeeze(1).numpy()).astype(np.float64)


def _drawn(given: RandomInput, rng: torch.Generator) -> torch.Tensor:
    if given.distribution == "normal":
        return torch.randn(SAMPLES, *given.shape, generator=rng)
    low, high = given.low or 0.0, given.high or 0.0
    return low + (high - low) * torch.rand(SAMPLES, *given.shape, generator=rng)


METRIC = "validation_edr"


def search_trial(
    config: Mapping[str, Any],
    train: MixtureConfig,
    arrays: TrainingArrays,
    checkpoints: Mapping[str, str],
    parent_run_id: str,
    tracking_uri: str,
    looks: int,
    scenarios: int,
) -> None:
    """Train with one choice of settings, and report the quality ``looks`` times."""
    torch.set_num_threads(train.resources.threads)
    settings = dict(config["settings"])
    gan = type(train.local).model_validate(train.local.model_dump() | settings)
    encoder = load_encoder(train.vae, arrays.world.sensor, Path(checkpoints["vae"]))
    validation = Validation.draw(encoder, arrays.world, scenarios)
    mixture, seed = Mixture(train, arrays), derived_seed(train.seed, "search")
    gate = mixture.load_gate(Path(checkpoints["gate"]))
    with seeded_initialisation(seed):
        module = mixture.local_module(gan, None, seed, gate)
    name = "search " + tune.get_context().get_trial_id()
    run = Tracking(tracking_uri).start(
        EXPERIMENT, name, parent_run_id=parent_run_id, tags={TAG_STAGE: "search-trial"}
    )
    with run:
        run.params({key: str(value) for key, value in settings.items()})
        look = _Look(gan, mixture, gate, validation, run, -(-gan.steps // looks))
        fit_module(module, gan.steps, callbacks=[look])


class _Look(lightning.Callback):
    """Reports the quality now and then."""

    def __init__(
        self,
        gan: GanConfig,
        mixture: Mixture,
        gate: Gate,
        validation: Validation,
        run: RunLog,
        every: int,
    ) -> None:
        self.gan, self.mixture, self.gate = gan, mixture, gate
        self.validation, self.run, self.every = validation, run, every

    def on_train_batch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, *others: Any
    ) -> None:
        """Measure and report every so many steps, and at the end."""
        del others
        step = trainer.global_step
        if isinstance(pl_module, WganGpModule) and (step % self.every == 0 or step == self.gan.steps):
            found = self.validation.measure(self.mixture.gated(self.gate, [pl_module.generator], self.gan))
            self.run.metrics(pl_module.metrics() | found, step)
            # Tune ends a trial that falls behind inside of report, so the run must be whole by then.
            self.run.flush()
            tune.report(found | {"step": step, "run_id": self.run.run_id})


REDUCTION = 3
MEASURES = ("validation_precision", "validation_coverage", METRIC)


@dataclass(frozen=True, slots=True)
class Tried:
    """One trial of a search."""

    run_id: str
    settings: Mapping[str, Any]
    step: int
    metrics: Mapping[str, float]


def space() -> dict[str, Any]:
    """What is searched: keys of the section ``local`` to distributions."""
    points = [{"points_per_link": count, "side_m": 0.1} for count in (6, 12)]
    return {
        "hidden": tune.choice([64, 128, 192]),
        "critic_hidden": tune.choice([64, 128, 192]),
        "critic_steps": tune.choice([2, 4]),
        "noise_dim": tune.choice([2, 4]),
        "generator_learning_rate": tune.loguniform(3e-4, 3e-3),
        "critic_learning_rate": tune.loguniform(5e-4, 4e-3),
        "generator_lookups": tune.choice(points),
        "critic_lookups": tune.choice(points),
    }


def search(
    shared: Mapping[str, Any], steps: int, trials: int, seed: int, resources: ResourceConfig, storage: Path
) -> list[Tried]:
    """Asynchronous successive halving (Li et al. 2020) on the validation energy ratio, best first."""
    # Two cuts. Tune kills what it ends, so neither a third cut nor max_t may fall on a trial's last step.
    scheduler = ASHAScheduler(
        time_attr="step",
        max_t=steps + 1,
        grace_period=steps // REDUCTION**2 + 1,
        reduction_factor=REDUCTION,
    )
    tuner = tune.Tuner(
        tune.with_resources(
            tune.with_parameters(search_trial, **shared),
            # No GPU, for its networks and its measurements stay on processors.
            resources.of_a_trial() | {"gpu": 0.0},
        ),
        param_space={"settings": space()},
        tune_config=tune.TuneConfig(
            metric=METRIC,
            mode="min",
            scheduler=scheduler,
            search_alg=BasicVariantGenerator(random_state=derived_seed(seed, "searched settings") % 2**32),
            num_samples=trials,
            reuse_actors=False,
        ),
        run_config=tune.RunConfig(name=storage.name, storage_path=str(storage.parent), verbose=0),
    )
    grid = tuner.fit()
    tried = [
        _tried(result)
        for result in map(grid.__getitem__, range(len(grid)))
        if METRIC in (result.metrics or {})
    ]
    for one in tried:
        # Tune does not wait until a trial that it ends has said so.
        if one.step < steps:
            RunLog(Tracking(shared["tracking_uri"]), one.run_id).finish("KILLED")
    if not tried:
        raise JobError("the search found nothing", got="; ".join(map(str, grid.errors)) or "no reports")
    # A trial that went further was better at every cut before; among equals the lower ratio counts.
    return sorted(tried, key=lambda one: (-one.step, one.metrics[METRIC]))


def _tried(result: Any) -> Tried:
    metrics = {name: float(result.metrics[name]) for name in MEASURES}
    return Tried(result.metrics["run_id"], result.config["settings"], int(result.metrics["step"]), metrics)
