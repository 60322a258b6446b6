"""What a scene model takes places for, asked with a ball in an arm's place."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from torch import Tensor, nn

from cspace.simulator import Split
from cspace.world import GridArm, World
from cspace.worlds import simulator_of, usual_world
from training.models.export import exported
from training.models.grid_head import GridHead, SceneModel, counts_of

# Scenes and hidden places of each by which a ball's probability is fitted.
SCENES, PLACES = 8, 4000
# Places are never taken for free more surely than 1 - this, so that log odds are finite.
_SURE = 1e-6


def ball(arm: GridArm) -> GridArm:
    """A ball of a voxel's radius in an arm's place: twice, for a head looks at the two nearest spheres."""
    sphere = np.array([[0.0, 0.0, 0.0, arm.voxel_m]])
    return replace(
        arm,
        origins=np.eye(4)[None],
        axes=np.array([[0.0, 0.0, 1.0]]),
        spheres_m=np.concatenate([sphere, sphere]),
        own_radii_m=np.full(2, arm.voxel_m),
        links=np.ones(2, dtype=np.int64),
        touching=(),
        group_spheres_m=sphere,
        group_links=np.ones(1, dtype=np.int64),
        members=np.array([[0, 1]]),
    )


class Ball(nn.Module):
    """Places (n, 3) m to the probability that a ball there touches something, (n,), for one picture."""

    def __init__(self, model: SceneModel, world: World, scale: tuple[float, float] = (1.0, 0.0)) -> None:
        super().__init__()
        arm = ball(world.grid_arm(model.config.groups))
        self.head, self.scale = GridHead(model, arm, counts_of(world)), scale

    def log_odds(self, image: Tensor, map_: Tensor, places: Tensor) -> Tensor:
        """Those of the model that something is touched, (n,)."""
        count = places.shape[0]
        turn = torch.eye(3).unsqueeze(-1).expand(3, 3, count)
        frames = torch.cat([turn, torch.zeros(3, 1, count), turn, places.T.unsqueeze(1)], dim=1)
        found = self.head.at_frames(image, map_, frames, None, (1, count))
        clear = found.clear[0].clamp(max=-_SURE)
        return torch.log(-torch.expm1(clear)) - clear

    def forward(self, image: Tensor, map_: Tensor, places: Tensor) -> Tensor:
        """Probabilities."""
        a, b = self.scale
        return torch.sigmoid(a * self.log_odds(image, map_, places) + b)


def belief_graph(model: SceneModel, world: World) -> bytes:
    """ONNX bytes: ``image``, ``map``, ``places`` (n, 3) m in the base frame to ``occupied`` (n,).

    The probability that a ball of a voxel's radius touches something is fitted to places that no camera sees
    in simulated scenes of the arm: taken from the model as it is, it would be too low, for a ball is smaller
    than all that the model has learned with.
    """
    ball_of = Ball(model, world).eval()
    ball_of.scale = _fitted(ball_of, world)
    image = torch.zeros(1, 2, *ball_of.head.counts)
    with torch.no_grad():
        inputs = (image, ball_of.head.encode(image), torch.zeros(2, 3))
    rows = {0: torch.export.Dim("places", min=1)}
    return exported(ball_of, inputs, ["image", "map", "places"], ["occupied"], ({}, {}, rows))


@torch.no_grad()
def _fitted(model: Ball, world: World) -> tuple[float, float]:
    """The scale of a :class:`Ball` for a world's validation scenes; 1 and 0 where these hide nothing."""
    # Usual scenes where nobody knows the world's own, as with recordings.
    scenes = getattr(world, "scenes", None)
    simulator: Any = simulator_of(usual_world(world.body, sensor=world.sensor, scenes=scenes))
    rng, odds, truth = np.random.default_rng(0), [], []
    for scene in simulator.scenes(Split.VALIDATION, 0, SCENES):
        places, distances = simulator.unseen_places(scene)
        drawn = rng.permutation(len(places))[:PLACES]
        image = torch.from_numpy(world.sensor.to_network(simulator.render(scene)[None]))
        asked = torch.from_numpy(places[drawn].astype(np.float32))
        odds.append(model.log_odds(image, model.head.encode(image), asked).numpy())
        truth.append(distances[drawn] < model.head.voxel_m)
    labels: NDArray[np.bool_] = np.concatenate(truth)
    if labels.all() or not labels.any():
        return 1.0, 0.0
    fit = LogisticRegression(C=np.inf).fit(np.concatenate(odds)[:, None], labels)
    return float(fit.coef_[0, 0]), float(fit.intercept_[0])
