"""The paper's comparison: four columns over one data set, trained by the real job and measured alike.

    python -m benchmarks.paper --out paper-study
    python -m benchmarks.paper --out paper-study --share 1 --hidden 512

Trains every column with an MLflow store in the output folder, on a GPU where there is one, and writes Table
1 with GS-C (table.md) and a figure of reconstructed free spaces (reconstruction.png). Stopped at any time,
the same command continues. Exit codes: 0 done, 1 failed, 2 wrong input.
"""

import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from benchmarks.command import arguments
from benchmarks.machine import ROOT, machine
from cspace.bundle import Bundle
from cspace.errors import CspaceError, InputError, JobError
from cspace.simulator import Split
from services.commands import report_error
from services.evaluator.evaluation import estimates_of, measure_topology, reconstruct, sample_clouds
from services.evaluator.metrics import Task
from services.evaluator.report import COLLISION_COLOUR, FREE_COLOUR, SHOWN_SAMPLES, free_map
from services.evaluator.scenes import Scene, Stage, unfiltered
from services.planner.samples import BundleSampler
from training.config import TrainConfig

SCORE, DRAWS, TOPOLOGY_SCENES = "gsc_boundary", 50, 8


@dataclass(frozen=True, slots=True)
class Column:
    """One way to train: a label in tables and figures, and a preset of the training job."""

    name: str
    label: str
    preset: str


# Trains the encoder that the other columns take unless they train one jointly, and so comes first.
BASE = Column("single", "encoder apart, no means", "paper_single")
COLUMNS = (
    BASE,
    Column("joint", "encoder trained jointly", "paper_joint"),
    Column("means", "K = 4 means, one cluster", "paper_means"),
    Column("clusters", "two clusters, local critics", "paper"),
)


def overrides(column: Column, share: float, hidden: int, encoder: Path | None) -> list[str]:
    """What a column's job is told beside its preset: steps, width and the shared encoder."""
    plain = TrainConfig.load(column.preset, [])
    sections = plain.to_dict()
    steps = {name: sections[name]["steps"] for name in ("vae", "local", "global") if name in sections}
    gans = [name for name in steps if name != "vae"]
    widths = [f"{part}.{key}={hidden}" for part in gans for key in ("hidden", "critic_hidden")]
    return [
        *(f"{name}.steps={max(1, round(share * count))}" for name, count in steps.items()),
        *widths,
        f"resources.gpus_per_trial={1.0 if torch.cuda.is_available() else 0.0}",
        # Hours on a shared machine: Ray takes a worker that gets no processor for dead.
        "resources.max_failures=20",
        *([] if encoder is None or plain.trains_encoder else [f"vae.checkpoint={encoder}"]),
    ]


def train(out: Path, column: Column, settings: Sequence[str]) -> Path:
    """The folder of a column's finished job, which is begun or continued.

    Raises:
        JobError: the job failed.
    """
    log = out / "logs" / f"{column.name}.log"
    if not _finished(log):
        log.parent.mkdir(parents=True, exist_ok=True)
        environment = os.environ | {
            "RAY_ADDRESS": "local",
            "RAY_AUTH_MODE": "disabled",
            "MLFLOW_TRACKING_URI": f"sqlite:///{out / 'mlflow.db'}",
            "CSPACE_DATA_DIR": str(out / "data"),
            "PYTHONPATH": str(ROOT),
            "OMP_NUM_THREADS": "1",
        }
        given = ["--preset", column.preset, "--job", f"paper-{column.name}"]
        given += [part for one in settings for part in ("--set", one)]
        command = [sys.executable, str(ROOT / "training" / "cluster_train.py"), *given]
        with log.open("ab") as file:
            # MLflow puts the artifacts of a store without a server below the working folder.
            code = subprocess.run(command, cwd=out, env=environment, stdout=file, stderr=file, check=False)
        if not _finished(log):
            raise JobError(
                f"the job of the column {column.name} failed", got=f"exit code {code.returncode}; see {log}"
            )
    run_id = re.findall(r"^run: (\w+)$", log.read_text("utf-8", "replace"), re.MULTILINE)[0]
    return out / "data" / "jobs" / run_id


def _finished(log: Path) -> bool:
    return (
        log.is_file() and re.search(r"^RESULT ", log.read_text("utf-8", "replace"), re.MULTILINE) is not None
    )


def encoder_of(folder: Path) -> Path:
    """The checkpoint of a job's auto-encoder."""
    return folder / "pictures" / "vae" / "final.ckpt"


def measure(label: str, split: Split, seed: int, bundle: Bundle, scenarios: int) -> list[dict[str, str]]:
    """Precision, coverage, EDr and GS-C of a bundle, with uniform and real samples beside it."""
    stage, sampler = Stage(bundle.spec.world, split, seed), BundleSampler(bundle)
    scenes = [Scene(stage, index) for index in range(scenarios)]
    found = estimates_of([row for scene in scenes for row in reconstruct(scene, sampler)], seed)
    rows = [row for scene in scenes[:TOPOLOGY_SCENES] for row in measure_topology(scene, sampler, DRAWS)]
    topology = estimates_of(rows, seed, Task.TOPOLOGY)
    score, floor = topology["", SCORE], topology["", f"{SCORE}_floor"]
    named = {label: "sampler", "uniform": "uniform", "real": "real"}
    gsc = f"{score.scaled(1e4):.1f} ({1e4 * floor.estimate:.1f})"
    shown = "seen" if split is Split.TRAIN else "unseen"
    return [
        {
            "column": name,
            "scenarios": shown,
            "precision": f"{found[key, 'precision']:.3f}",
            "coverage": f"{found[key, 'coverage']:.3f}",
            "EDr": f"{found[key, 'edr']:.3f}",
            "GS-C x 1e4 (noise floor)": gsc if name == label else "",
        }
        for name, key in named.items()
    ]


def reconstruction(scenes: Sequence[Scene], bundles: Mapping[str, Bundle]) -> Figure:
    """One row a scenario: its picture, real samples, and each column's samples with its GS-C."""
    count = len(bundles) + 2
    figure = Figure(figsize=(2.15 * count, 2.75 * len(scenes) + 0.4), layout="constrained")
    panels = figure.subplots(len(scenes), count, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        row[0].imshow(scene.image)
        row[0].set_axis_off()
        clouds = [(scene.free(SHOWN_SAMPLES, scene.rng(7)), None)]
        for bundle in bundles.values():
            sampler = BundleSampler(bundle)
            samples = unfiltered(sampler, scene.image, SHOWN_SAMPLES, scene.sampler_seed())
            clouds.append((samples, sample_clouds(scene, sampler, DRAWS).complement_scores[0][0]))
        for axes, (samples, score) in zip(row[1:], clouds, strict=True):
            free = scene.checker.valid_batch(samples)
            free_map(axes, scene)
            for mask, colour in ((free, FREE_COLOUR), (~free, COLLISION_COLOUR)):
                axes.scatter(samples[mask, 0], samples[mask, 1], s=4, color=colour, linewidths=0)
            gsc = "" if score is None else f", GS-C {1e4 * score:.1f}e-4"
            axes.set(xticks=[], yticks=[], aspect="equal", xlabel=f"{free.mean():.1%} free{gsc}")
    for axes, label in zip(panels[0], ("picture", "real samples", *bundles), strict=True):
        axes.set_title(label.replace(", ", ",\n"), fontsize=10)
    return figure


def typical(stage: Stage, among: int = 21) -> Scene:
    """The scenario whose free share is the median of the first ones, so that nobody picks what is shown."""
    scenes = [Scene(stage, index) for index in range(among)]
    shares = [
        float(scene.checker.valid_batch(scene.space.sample_uniform(scene.rng(8), SHOWN_SAMPLES)).mean())
        for scene in scenes
    ]
    return scenes[int(np.argsort(shares, kind="stable")[among // 2])]


def main(given: Sequence[str] | None = None) -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of jobs and results")
    parser.add_argument("--share", type=float, default=0.1, help="of the paper's steps (0.1)")
    parser.add_argument("--hidden", type=int, default=128, help="width of generators and critics (128)")
    parser.add_argument("--scenarios", type=int, default=100, help="seen and unseen, for the table (100)")
    options = parser.parse_args(given)
    out, say = options.out.resolve(), partial(print, flush=True)
    out.mkdir(parents=True, exist_ok=True)
    bundles: dict[str, Bundle] = {}
    encoder = None
    try:
        for column in COLUMNS:
            say(f"training: {column.label}")
            folder = train(out, column, overrides(column, options.share, options.hidden, encoder))
            encoder = encoder_of(folder) if column is BASE else encoder
            bundles[column.label] = Bundle.load(folder / "bundle")
        rows = []
        for split in (Split.TRAIN, Split.TEST):
            for label, bundle in bundles.items():
                say(f"measuring: {label}, {split}")
                rows += measure(label, split, 0, bundle, options.scenarios)
    except CspaceError as error:
        return report_error(error, InputError, program="paper")
    table = pd.DataFrame(rows).drop_duplicates(["column", "scenarios"])
    text = table.to_markdown(index=False, disable_numparse=True)
    (out / "table.md").write_text(f"{text}\n", encoding="utf-8")
    world = next(iter(bundles.values())).spec.world
    scenes = [typical(Stage(world, split, 0)) for split in (Split.TRAIN, Split.DEMO)]
    reconstruction(scenes, bundles).savefig(out / "reconstruction.png", dpi=100)
    say(f"{machine()}\n\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
