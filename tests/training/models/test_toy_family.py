"""A model family that a newcomer adds in one file is configured, trained, exported, served and compared."""

import base64
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from pydantic import Field
from torch import nn

from cspace.bundle import RandomInput
from cspace.errors import ConfigError
from cspace.files import encode_png
from cspace.worlds.planar.world import PlanarWorld
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from services.evaluator.evaluation import Budget, Evaluation, Setting, run_unit, table_of, units
from services.evaluator.report import terminal_table
from services.planner.samples import BundleSampler
from tests.inference_api.client import running
from tests.training.models.builders import run, save
from training.clusters.bundling import TrainedParts, make_bundle
from training.clusters.pipeline import cluster_data, encode_data, prepare_data
from training.config import TrainConfig, TrialSettings
from training.models.autoencoders import VaeModule, shown
from training.models.checkpoint import seeded_initialisation, trained
from training.models.export import Sampler
from training.models.families import Family, Trial, families, register
from training.models.modules import TrialModule


# The newcomer's file, from here ...
class ToySettings(TrialSettings):
    steps: int = Field(60, ge=1)
    learning_rate: float = Field(1e-2, gt=0)


class ToyConfig(TrainConfig):
    toy: ToySettings = ToySettings()


class Gaussian(nn.Module):
    """A normal distribution of configurations around a mean that the picture's latent tells."""

    def __init__(self, latent_dim, dim):
        super().__init__()
        self.mean, self.log_std = nn.Linear(latent_dim, dim), nn.Parameter(torch.zeros(dim))

    def forward(self, latent, noise):
        return self.mean(latent) + self.log_std.exp() * noise


class ToyModule(TrialModule):
    def __init__(self, config, samples, seed):
        super().__init__(seed)
        self.samples = samples
        self.net = Gaussian(samples.mu.shape[1], samples.configurations.shape[1])
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

    def training_step(self, step, batch_index):
        batch = self.samples.draw(64, self.rng)
        error = (batch.configurations - self.net.mean(batch.mu)) / self.net.log_std.exp()
        loss = (0.5 * error.square() + self.net.log_std).mean()
        self.descend(loss)
        self.latest = {"toy_loss": loss.detach()}


class ToySampler(Sampler):
    def __init__(self, net, space):
        super().__init__()
        self.net, self.random_inputs = net, (RandomInput("noise", "normal", (space.dim,)),)

    def forward(self, latent, noise):
        return (torch.remainder(self.net(latent, noise) + torch.pi, 2 * torch.pi) - torch.pi).unsqueeze(1)


@register("toy")
class Toy(Family[ToyConfig]):
    configuration = ToyConfig

    def stages(self):
        return {"toy": ["toy"]}

    def trial(self, name, seed, done):
        return Trial(ToyModule(self.config.toy, self.arrays.samples(None), seed), self.config.toy)

    def sampler(self, done):
        space, latent_dim = self.arrays.world.space, self.arrays.mu.shape[1]
        return ToySampler(trained(lambda: Gaussian(latent_dim, space.dim), done["toy"], "net"), space)


# ... to here.

SMALL = {"scenario_count": 12, "free_per_scenario": 64, "collision_per_scenario": 0, "extra_image_count": 0}


def config_of(**sections):
    clusters = {"form": "toy", "count": 1}
    return TrainConfig.from_dict(
        {"clusters": clusters, "data": SMALL, "validity": {"steps": 0}, "preset": "toy", **sections}
    )


def test_its_section_is_read_by_the_name_of_the_family_and_by_no_other():
    assert "toy" in families()
    config = config_of(toy={"steps": 7})
    assert isinstance(config, ToyConfig)
    assert config.toy.steps == 7
    assert TrainConfig.from_dict(config.to_dict()) == config
    with pytest.raises(ConfigError, match=r"toy is unknown"):
        TrainConfig.load("smoke", ["toy.steps=7"])
    with pytest.raises(ConfigError, match=r"clusters\.form is unknown; expected guided, joint, mixture, toy"):
        TrainConfig.load("smoke", ["clusters.form=nothing"])


@pytest.mark.slow
def test_it_is_trained_exported_served_and_compared_as_every_other(tmp_path):
    vae = {"latent_dim": 4, "width": 4, "steps": 1, "checkpoint": str(tmp_path / "vae.ckpt")}
    config = config_of(vae=vae)
    job = SimpleNamespace(config=config, folder=tmp_path)
    dataset = prepare_data(config, tmp_path)
    pictures = torch.tensor(shown(dataset.world.sensor, dataset.images))
    with seeded_initialisation(0):
        save(tmp_path / "vae.ckpt", VaeModule(config.vae, pictures, 0))
    arrays = encode_data(job, dataset, None, cluster_data(job, dataset))

    family = families()["toy"](config, arrays)
    done, losses = {}, []
    for stage, names in family.stages().items():
        for name in names:
            with seeded_initialisation(0):
                made = family.trial(name, 0, done)
            losses += [
                run(made.module, steps).metrics()["toy_loss"] for steps in (1, made.settings.steps - 1)
            ]
            done[name] = save(tmp_path / stage / name / "final.ckpt", made.module)
    assert losses[-1] < losses[0]

    parts = TrainedParts(tmp_path / "vae.ckpt", done, None, arrays)
    bundle = make_bundle(tmp_path / "bundle", config, dataset, parts)
    assert bundle.spec.provenance.config["toy"]["steps"] == 60

    settings = ApiSettings(registry_uri=None, model_cache=tmp_path / "cache", pretrained_model=bundle.folder)
    white = base64.b64encode(encode_png(np.full((48, 48, 3), 255, np.uint8))).decode()
    with running(create_app(settings, None)) as client:
        answer = client.post("/sample", json={"image": white, "n": 9, "min_confidence": 0})
    assert np.shape(answer.json()["samples"]) == (9, 2)

    setting = Setting(PlanarWorld(), 5, Budget(3, 50, 0, 0, 1, 0, 1))
    results = [run_unit(unit, setting, BundleSampler(bundle)) for unit in units(setting)]
    evaluation = Evaluation(setting, "toy/1", table_of(results, "toy/1"), 1.0)
    precision = evaluation.estimate("precision", "sampler", "uniform")
    assert 0.0 <= precision.low <= precision.estimate <= precision.high <= 1.0
    assert "precision" in terminal_table(evaluation)
