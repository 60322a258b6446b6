"""What a sweep is asked for."""

from collections.abc import Mapping
from dataclasses import dataclass

from training.config.clusters import TrainConfig
from training.sweeps.grid import Point


@dataclass(frozen=True)
class Plan:
    """A sweep.

    Args:
        name: by which it goes on.
        preset: of all points.
        overrides: of all points.
        configs: the whole configuration of each point.
        at_once: points that run side by side.
        sort: what the final table goes by.
        scenarios: validation scenarios that judge a point.
        register: whether every point's bundle becomes a version.
    """

    name: str
    preset: str
    overrides: tuple[str, ...]
    configs: Mapping[Point, TrainConfig]
    at_once: int
    sort: str
    scenarios: int
    register: bool
