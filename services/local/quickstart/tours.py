"""What the main job does for a robot: its entry points, and how much is looked at."""

from dataclasses import dataclass

from cspace.world import World
from cspace.worlds import examples
from services.registry.references import PRETRAINED

EVALUATE = "python -m services.evaluator --model {model} --without-shipped"


@dataclass(frozen=True, slots=True)
class Tour:
    """The main job of one robot.

    Args:
        robot: name of the example.
        shipped: the model that comes with the server.
        train: entry point of the training job.
        evaluate: of the evaluation job, with ``{model}`` where the version goes.
        scenarios: on which served samples are judged.
        families: of the problems that are planned and drawn.
    """

    robot: str
    shipped: str
    train: str
    evaluate: str
    scenarios: int
    families: tuple[str, ...]

    @property
    def world(self) -> World:
        """The robot's."""
        return examples()[self.robot]


TOURS = {
    "planar": Tour(
        robot="two-link",
        shipped=PRETRAINED,
        train="python training/cluster_train.py --preset quickstart",
        evaluate=EVALUATE,
        scenarios=100,
        families=("uniform", "narrow"),
    ),
    "panda": Tour(
        robot="panda",
        shipped=f"{PRETRAINED}-panda",
        train="python training/cluster_train.py --preset panda_quick",
        evaluate=f"{EVALUATE} --scenarios 20",
        scenarios=20,
        families=("uniform", "shelf"),
    ),
}
USUAL = "planar"
