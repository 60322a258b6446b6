"""Do clusters pay? Every form of the per-cluster trials at an equal total budget, over seeds, in pairs.

    python -m benchmarks.training.clusters --out build/clusters --workers 2
    python -m benchmarks.training.clusters --out build/clusters --table
    python -m benchmarks.training.clusters --out build/clusters-arm --joints 7 --seeds 3 --workers 2

An arm is a form with or without look-ups. All arms of one number of joints share data, latents and validation
scenarios, and spend the same generator steps of the same batch on networks of the same width over all their
stages. Results are kept line by line, so that a run that was stopped goes on where it was.
"""

import multiprocessing
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from benchmarks.command import arguments
from benchmarks.lines import append, read
from benchmarks.training.clusters_report import write_report
from cspace.files import make_output_folder
from training.clusters.clustering import cluster, group, points_in_cells
from training.clusters.stages import uniform_free
from training.config.clusters import TrainConfig, load_config
from training.datasets.generate import generate
from training.models.cells import CellBase
from training.models.checkpoint import seeded_initialisation
from training.models.distillation import DistillationModule
from training.models.encode import encode
from training.models.gate import GateModule, gate_probabilities
from training.models.lookups.lookups import make_lookups, make_reader
from training.models.mixture import Experts, LookupSampler
from training.models.modules import VaeModule, WganGpModule
from training.models.networks import Encoder, TorusGenerator
from training.models.pictures.autoencoders import shown
from training.trials.arrays import GatedCells, TrainingArrays
from training.trials.loading import fresh_generator, gated_sampler, make_wgan
from training.trials.searching.quality import Validation

SCENARIOS = 40
WIDTH = {"hidden": 64, "critic_hidden": 64, "batch_size": 256}
# Of the generator and of the critic: along the links of planar arms, at the spheres of the arm in space.
LOOKUPS = ("{points_per_link: 12, side_m: 0.1}", "{points_per_link: 8, side_m: 0.1}")
LOOKUPS_IN_SPACE = ("{groups: 32}", "{groups: 32}")
# Worlds by the number of joints: planar ones, and the arm that sees with depth cameras.
IN_SPACE = 7
PRESETS = {2: "quickstart", 3: "three_link", IN_SPACE: "panda_quick"}


@dataclass(frozen=True, slots=True)
class Arm:
    """One form: the number of networks that train apart and the number of the gate's cells."""

    name: str
    form: str
    networks: int
    cells: int


ARMS = (
    Arm("single", "single", 1, 0),
    Arm("paper's form", "guided", 2, 0),
    *(Arm(f"histogram, {k} cells", "histogram", 0, k) for k in (4, 8, 16, 32)),
    *(Arm(f"mixture, {k} cells", "mixture", k, k) for k in (4, 8, 16, 32)),
    Arm("distilled, 16 cells", "distilled", 16, 16),
    Arm("one network, 32 cells", "mixture", 1, 32),
    Arm("2 networks, 32 cells", "mixture", 2, 32),
)


@dataclass(frozen=True)
class Task:
    """One training: which arm, with or without look-ups, for how many joints, from which seed."""

    arm: Arm
    lookups: bool
    joints: int
    seed: int
    steps: int

    @property
    def key(self) -> str:
        return f"{self.arm.name}|{self.lookups}|{self.joints}|{self.seed}|{self.steps}"

    def config(self) -> TrainConfig:
        # What this arm makes of clusters and networks is its own business, below.
        sets = ["clusters.form=guided", "clusters.count=1", f"gate.cells={self.arm.cells}"]
        for part in ("local", "global"):
            sets += [f"{part}.{key}={value}" for key, value in WIDTH.items()]
            if self.lookups:
                generator, critic = LOOKUPS_IN_SPACE if self.joints == IN_SPACE else LOOKUPS
                sets += [f"{part}.generator_lookups={generator}", f"{part}.critic_lookups={critic}"]
        return load_config(PRESETS[self.joints], [*BARE, *sets])


# The presets' own choices, taken back: here each arm makes its own.
BARE = [
    f"{part}.{key}={{points_per_link: 0}}"
    for part in ("local", "global")
    for key in ("generator_lookups", "critic_lookups")
]


def prepare(joints: int, out: Path) -> tuple[TrainingArrays, Encoder, torch.Tensor]:
    """Data, encoder and pictures for an arm with so many joints; trained once, kept in ``out``."""
    config = load_config(PRESETS[joints])
    dataset = generate(config.data, out / "data" / config.data.folder_name)
    images, weights = np.asarray(dataset.images), out / f"encoder-{joints}.safetensors"
    pictures = images if dataset.extra_images is None else np.concatenate([images, dataset.extra_images])
    pictures = torch.tensor(shown(dataset.world.sensor, pictures))
    with seeded_initialisation(0):
        module = VaeModule(config.vae, pictures, 0)
    if not weights.is_file():
        for step in range(config.vae.steps):
            module.training_step(step, step)
        save_file(module.encoder.state_dict(), weights)
    module.encoder.load_state_dict(load_file(weights))
    free, ids = uniform_free(dataset)
    empty = np.zeros((0, config.vae.latent_dim), dtype=np.float32)
    labels = np.zeros(len(free), dtype=np.int64)
    arrays = TrainingArrays(free, ids, labels, empty, empty, dataset.world, np.array(images))
    return arrays, module.encoder, pictures


class Trainer:
    """Trains the arms of one number of joints and measures them."""

    def __init__(self, joints: int, out: Path) -> None:
        self.arrays, encoder, self.pictures = prepare(joints, out)
        self.encode_with(encoder)
        self.validation = Validation.draw(self.encoder, self.arrays.world, SCENARIOS)

    def encode_with(self, encoder: Encoder) -> None:
        self.encoder = encoder.eval()
        latents = encode(self.encoder, self.arrays.world.sensor, self.arrays.images)
        self.arrays = replace(self.arrays, mu=latents.mu, sigma=latents.sigma)

    def run(self, task: Task) -> dict[str, object]:
        began = time.perf_counter()
        sampler = self.train(task)
        seconds = time.perf_counter() - began
        return {"key": task.key, "seconds": seconds, "rows": self.measure(sampler)}

    def train(self, task: Task) -> torch.nn.Module:
        arm, config = task.arm, task.config()
        arrays, gate = self.partition(task, config)
        lookups = make_lookups(config.local.generator_lookups, arrays.world)
        if arm.form in ("single", "guided"):
            generator = self.ungated(task, arrays)
            return generator if lookups is None else LookupSampler(generator, lookups)
        if arm.form == "histogram":
            with seeded_initialisation(0):
                still = fresh_generator(task.config().local, self.arrays)
            torch.nn.init.zeros_(still.residual[-1].weight)
            return gated_sampler(gate, arrays, [still], config.local.generator_lookups)
        budget = task.steps if arm.form == "mixture" else 3 * task.steps // 4
        gan = config.local.model_copy(update={"steps": budget // arm.networks})
        clusters = range(arm.networks)
        trained = [trained_wgan(gan, arrays, index, task.seed + index).generator for index in clusters]
        if arm.form == "distilled":
            trained = [self.distil(task, config, arrays, Experts(trained, _clusters(arrays)))]
        return gated_sampler(gate, arrays, trained, config.local.generator_lookups)

    def partition(self, task: Task, config: TrainConfig):
        arm, arrays = task.arm, self.arrays
        if arm.cells == 0:
            return arrays, None
        cells = cluster(arrays.configurations, arm.cells, 50_000, task.seed, arrays.world.space)
        clusters = group(cells, max(1, arm.networks), task.seed)
        gated = GatedCells(points_in_cells(cells, config.gate.points, task.seed), cells.labels, clusters)
        arrays = replace(arrays, labels=clusters[cells.labels], cells=gated)
        mu, sigma = torch.tensor(arrays.mu), torch.tensor(arrays.sigma)
        with seeded_initialisation(task.seed):
            module = GateModule(config.gate, mu, sigma, arrays.shares(), task.seed)
        for step in range(config.gate.steps):
            module.training_step(step, step)
        probabilities = gate_probabilities(module.gate, arrays.mu)
        return replace(arrays, cells=replace(gated, probabilities=probabilities)), module.gate

    def ungated(self, task: Task, arrays: TrainingArrays):
        gan, seed = task.config().local, task.seed
        if task.arm.form == "single":
            return trained_wgan(gan.model_copy(update={"steps": task.steps}), arrays, None, seed).generator
        labels = cluster(arrays.configurations, 2, 50_000, seed, arrays.world.space).labels
        split, quarter = replace(arrays, labels=labels), gan.model_copy(update={"steps": task.steps // 4})
        critics = [trained_wgan(quarter, split, index, seed + 1 + index).critic for index in (0, 1)]
        half = gan.model_copy(update={"steps": task.steps // 2})
        return trained_wgan(half, arrays, None, seed, critics, 1.0).generator

    def distil(self, task, config, arrays, teacher) -> TorusGenerator:
        # A step of the regression costs about a fifth of one of a WGAN-GP, which trains a critic too.
        steps = 5 * (task.steps // 4)
        with seeded_initialisation(task.seed):
            student = fresh_generator(config.local, arrays)
        reader = make_reader(config.local.generator_lookups, arrays.scenes())
        base = arrays.base(None)
        if not isinstance(base, CellBase):
            raise TypeError("a mixture starts in cells")
        gan = config.local.model_copy(update={"steps": steps})
        samples = arrays.samples(None)
        module = DistillationModule(gan, samples, teacher, reader, student, reader, base, task.seed)
        for step in range(steps):
            module.training_step(step, step)
        return student

    def measure(self, sampler: torch.nn.Module | None) -> list[list[float]]:
        """Precision, coverage, energy, k-NN recall in every scenario; of uniform samples for None."""
        rows = self.validation.rows(sampler)
        return [[row.precision, row.coverage, row.energy, row.knn_recall] for row in rows]


def trained_wgan(gan, arrays, cluster_index, seed, critics=None, weight=0.0) -> WganGpModule:
    module = make_wgan(gan, arrays, cluster_index, seed, critics, weight)
    for step in range(gan.steps):
        module.training_step(step, step)
    return module.eval()


def _clusters(arrays: TrainingArrays) -> torch.Tensor:
    return torch.tensor(arrays.cells.clusters)


_TRAINERS: dict[int, Trainer] = {}


def _work(job: tuple[Task, Path]) -> dict[str, object]:
    task, out = job
    torch.set_num_threads(1)
    if task.joints not in _TRAINERS:
        _TRAINERS[task.joints] = Trainer(task.joints, out)
    return _TRAINERS[task.joints].run(task)


def tasks(steps: int, seeds: int, joints: list[int]) -> list[Task]:
    """Seed after seed, so that a run that is stopped early has whole seeds."""
    return [
        Task(arm, lookups, dim, seed, steps)
        for seed in range(seeds)
        for dim in joints
        for arm in ARMS
        for lookups in ((False,) if arm.form == "histogram" else (False, True))
    ]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=640, help="generator steps of an arm in all")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--joints", type=int, nargs="+", default=[2, 3], choices=sorted(PRESETS))
    parser.add_argument("--workers", type=int, default=1, help="trainings at a time, one thread each")
    parser.add_argument("--table", action="store_true", help="only write the report of what is there")
    options = parser.parse_args()
    make_output_folder(options.out)
    results = options.out / "results.jsonl"
    known = {row["key"] for row in read(results)}
    if not options.table:
        torch.set_num_threads(1)
        for joints in options.joints:
            if f"uniform|{joints}" not in known:
                found = {"key": f"uniform|{joints}", "rows": Trainer(joints, options.out).measure(None)}
                append(results, found)
        left = [t for t in tasks(options.steps, options.seeds, options.joints) if t.key not in known]
        began = time.monotonic()
        with multiprocessing.get_context("spawn").Pool(options.workers) as pool:
            jobs = ((task, options.out) for task in left)
            for count, found in enumerate(pool.imap_unordered(_work, jobs), start=1):
                append(results, found)
                rest = (time.monotonic() - began) / count * (len(left) - count)
                quality = np.mean(np.array(found["rows"]), axis=0).round(3)
                print(f"{count}/{len(left)} {found['key']} {quality}, {rest:.0f} s left", flush=True)
    write_report(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
