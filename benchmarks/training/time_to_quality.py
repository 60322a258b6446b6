"""Steps a second, and seconds until the sampler is good: EDr below 0.3, precision above 0.84, one thread.

    python -m benchmarks.training.time_to_quality --out build/time --repeats 3

Trains what the quickstart trains, one part after the other on one thread (or on a GPU where there is one),
and stops the clock whenever it looks at the quality, on validation scenarios. Beside it, in the same run,
steps a second of the local WGAN-GP in our loop and in a plain Lightning loop of the same mathematics, which
fetches shuffled batches from a data loader.
"""

import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Self

import lightning
import torch
from torch.utils.data import DataLoader, TensorDataset

from benchmarks.command import arguments
from benchmarks.lines import spread
from benchmarks.training.clusters import Trainer
from benchmarks.training.forgetful import ForgetfulRun, report_nothing
from cspace.files import make_output_folder
from training.clusters.stages import partition
from training.config.clusters import load_config
from training.models.checkpoint import seeded_initialisation
from training.models.data import Batch, ScenarioSamples
from training.models.gate import GateModule, gate_probabilities
from training.models.modules import VaeModule, WganGpModule
from training.trials.checkpoints import TrialFolder
from training.trials.fit import Rhythm, fit
from training.trials.loading import gated_sampler, make_wgan

BELOW_EDR, ABOVE_PRECISION = 0.3, 0.84
LOOK_EVERY = 10


class Clock:
    """Runs only while it is entered."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __enter__(self) -> Self:
        self.began = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        self.seconds += time.perf_counter() - self.began


def time_to_quality(trainer: Trainer, seed: int) -> dict[str, object]:
    """Seconds by part until the quality is reached, or what was reached at the preset's end."""
    config = load_config("quickstart", [f"seed={seed}"])
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    clocks = {name: Clock() for name in ("vae", "cells and gate", "generators")}
    with seeded_initialisation(seed):
        vae = VaeModule(config.vae, trainer.pictures, seed).to(device)
    with clocks["vae"]:
        for step in range(config.vae.steps):
            vae.training_step(step, step)
    trainer.encode_with(vae.encoder.cpu())
    arrays, validation = trainer.arrays, replace(trainer.validation, encoder=trainer.encoder)
    with clocks["cells and gate"]:
        parted = partition(config, arrays.configurations, arrays.world.space)
        labels, gated = parted.labels, parted.gated(config.gate, config.seed)
        arrays = replace(arrays, labels=labels, cells=gated)
        with seeded_initialisation(seed):
            gate = GateModule(
                config.gate, torch.tensor(arrays.mu), torch.tensor(arrays.sigma), arrays.shares(), seed
            )
        for step in range(config.gate.steps):
            gate.training_step(step, step)
        probabilities = gate_probabilities(gate.gate, arrays.mu)
        arrays = replace(arrays, cells=replace(gated, probabilities=probabilities))
        modules = [
            make_wgan(config.local, arrays, index, seed + 1 + index).to(device)
            for index in range(config.clusters.count)
        ]
        for module in modules:
            module.on_fit_start()
    found = {}
    for first in range(0, config.local.steps, LOOK_EVERY):
        with clocks["generators"]:
            for module in modules:
                for step in range(first, first + LOOK_EVERY):
                    module.training_step(step, step)
        generators = [module.generator.cpu() for module in modules]
        sampler = gated_sampler(gate.gate, arrays, generators, config.local.generator_lookups)
        found = {"steps": first + LOOK_EVERY} | validation.measure(sampler)
        for module in modules:
            module.generator.train().to(device)
        print(f"seed {seed}: {found}", flush=True)
        if found["validation_edr"] < BELOW_EDR and found["validation_precision"] > ABOVE_PRECISION:
            break
    parts = {name: clock.seconds for name, clock in clocks.items()}
    return found | {"seconds": sum(parts.values()), **parts}


class PlainLoop(lightning.LightningModule):
    """The same step, fed by a data loader: a batch for every critic step and one for the generator's."""

    def __init__(self, module: WganGpModule) -> None:
        super().__init__()
        self.module, self.automatic_optimization = module, False

    def configure_optimizers(self):
        return self.module.training_optimisers

    def training_step(self, batch, index):
        del index
        module = self.module
        critic, generator = self.optimizers()
        parts = [tensor.split(module.config.batch_size) for tensor in batch]
        for number, (configurations, ids) in enumerate(zip(*parts, strict=True)):
            real = Batch(configurations, ids, module.samples.mu[ids], module.samples.sigma[ids])
            last = number == module.config.critic_steps
            loss = module.generator_step_loss(real) if last else module.critic_step_loss(real)
            optimiser = generator if last else critic
            optimiser.zero_grad()
            self.manual_backward(loss)
            optimiser.step()
        self.log_dict(module.metrics())


def steps_per_second(trainer: Trainer, plain: bool, steps: int) -> float:
    """Generator steps a second of the quickstart's local WGAN-GP, after a warm-up of a few steps."""
    bare = ["gate.cells=0", "clusters.form=guided", "global.local_critic_weight=0"]
    config = load_config("quickstart", [*bare, f"local.steps={steps}"])
    module = make_wgan(config.local, trainer.arrays, 0, 0)
    for step in range(3):
        module.training_step(step, step)
    began = time.perf_counter()
    if plain:
        samples: ScenarioSamples = module.samples
        data = TensorDataset(samples.configurations, samples.ids)
        size = config.local.batch_size * (config.local.critic_steps + 1)
        loop = lightning.Trainer(
            max_epochs=1,
            limit_train_batches=steps,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
        )
        loop.fit(PlainLoop(module), DataLoader(data, size, shuffle=True))
    else:
        with tempfile.TemporaryDirectory() as folder:
            kept = TrialFolder(Path(folder))
            fit("local-0", module, steps, Rhythm(20, 10**9), ForgetfulRun(), kept, report_nothing)
    return steps / (time.perf_counter() - began)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--steps", type=int, default=40, help="of each timed loop")
    options = parser.parse_args()
    torch.set_num_threads(1)
    make_output_folder(options.out)
    trainer = Trainer(2, options.out)
    rates = {"ours": [], "plain": []}
    for turn in range(options.repeats):
        for name in ("ours", "plain") if turn % 2 == 0 else ("plain", "ours"):
            rates[name].append(steps_per_second(trainer, name == "plain", options.steps))
    ratios = [a / b for a, b in zip(rates["ours"], rates["plain"], strict=True)]
    for name, values in (*rates.items(), ("ours over plain", ratios)):
        print(f"{name}: {spread(values, 2)}")
    reached = [time_to_quality(trainer, seed) for seed in range(options.repeats)]
    (options.out / "time.json").write_text(json.dumps({"rates": rates, "reached": reached}, indent=2))
    seconds = [float(row["seconds"]) for row in reached]
    print(f"time to quality, s: {spread(seconds, 0)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
