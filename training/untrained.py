"""``python -m training.untrained ROBOT FOLDER``: a model of an arm by the shipped scene model, in minutes.

Nothing is trained. The scene model scores configurations and paths of any arm; samples are uniform ones that
it takes for free. What the bundle states of itself, its threshold and its plans' calibration, is fitted to
simulated scenes of the arm. With ``--register`` it becomes a version of ``<robot>-sampler``.

A folder that holds this very model already is taken as it is, so that the command may be given again.

Exit codes: 0 done, 1 the disk or the registry is bad, 2 the command or the robot is wrong.
"""

import argparse
import hashlib
import logging
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.bundle import Bundle, BundleSpec, RandomInput, write_bundle
from cspace.errors import ConfigError, CspaceError, InputError
from cspace.world import World
from cspace.worlds import robot_digest
from services.commands import report_error
from services.names import label, model_name
from services.registry import tracking_uri
from training.clusters.bundling import FALLBACK_THRESHOLD, head_graphs, with_choices
from training.config import HeadConfig, TrainConfig
from training.jobs.job import ALIASES, register_untrained
from training.jobs.provenance import provenance
from training.models.autoencoders import network_size
from training.models.export import blind_encoder_graph, uniform_graph

PRESET = "panda_quick"


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, make, print."""
    options = parser().parse_args(arguments)
    logging.basicConfig(format="%(message)s")
    logging.getLogger("training").setLevel(logging.INFO)
    try:
        uri = None if options.register is None else tracking_uri()
        robot = str(Path(options.robot).absolute()) if Path(options.robot).is_file() else options.robot
        settings = [f"data.robot={robot}", f"validity.plan_problems={options.plan_problems}"]
        if options.scene_model is not None:
            settings.append(f"validity.scene_model={options.scene_model.absolute()}")
        config = TrainConfig.load(PRESET, settings)
        model = model_name(config.world, label(config.world))
        bundle = made_or_found(options.folder, config.world, config.validity)
        print(f"{bundle.folder}\n  digest {bundle.digest}", flush=True)
        if uri is not None:
            version = register_untrained(bundle, uri, model, options.register, "untrained")
            print(f"  registered as {version}")
    except CspaceError as error:
        return report_error(error, InputError, ConfigError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.untrained",
        description="Make a model of an arm in space by the shipped scene model; nothing is trained.",
        epilog="Reads MLFLOW_TRACKING_URI with --register. Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("robot", help="panda, ur5, or a file that python -m training.robots import wrote")
    parser.add_argument("folder", type=Path, help="where the bundle goes")
    parser.add_argument("--scene-model", type=Path, help="of yours (default: the shipped one)")
    parser.add_argument(
        "--plan-problems",
        type=int,
        default=40,
        help="simulated ones by which plans are calibrated; 0 for none (default: %(default)s)",
    )
    parser.add_argument("--register", choices=ALIASES, help="make it a version of the robot's model")
    return parser


def made_or_found(folder: Path, world: World, config: HeadConfig) -> Bundle:
    """The model that the folder holds already, or one that is made there."""
    file = config.scene_model_file
    if file is None or not file.is_file():
        raise ConfigError("there is no scene model", expected="validity.scene_model", got=str(file))
    recipe = {
        "robot_name": label(world),
        "samples": "uniform",
        "plan_problems": config.plan_problems,
        "source_digest": hashlib.sha256(file.read_bytes()).hexdigest(),
    }
    if folder.is_dir():
        found = Bundle.load(folder)
        same_arm = robot_digest(found.spec.world) == robot_digest(world)
        made = dict(found.spec.provenance.config)
        # More plans calibrate no worse.
        enough = made.get("plan_problems", -1) >= config.plan_problems
        if same_arm and enough and made | {"plan_problems": config.plan_problems} == recipe:
            return found
    spec = BundleSpec(
        world=world,
        latent_dim=1,
        random_inputs=(RandomInput("base", "uniform", (world.dim,), -math.pi, math.pi),),
        confidence_threshold=config.threshold or FALLBACK_THRESHOLD,
        provenance=provenance(recipe),
    )
    graphs = {
        "encoder": blind_encoder_graph(network_size(world.sensor)),
        "generator": uniform_graph(world.space),
        **head_graphs(config, world, file),
    }
    draft = folder.with_name(folder.name + "-draft")
    return Bundle.load(write_bundle(folder, with_choices(draft, config, spec, graphs), graphs))


if __name__ == "__main__":
    sys.exit(main())
