"""What the novelty of a picture tells: how high it is for pictures unlike the training's, and what samples
are worth there.

    python -m benchmarks.evaluation.novelty inference_api/pretrained --scenarios 100

Every kind changes the first test scenarios or their pictures in one way. The samples are judged by what is
true of the scenario, whatever the picture shows: those of the generator alone, and those that the bundle
serves.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.bundle import Bundle
from cspace.splits import Split, scenario_rng
from cspace.worlds.planar.planning.collision import CollisionChecker
from cspace.worlds.planar.render import render
from cspace.worlds.planar.scene import Disc, Scenario, random_scenario
from cspace.worlds.planar.seeing.camera import Camera
from services.evaluator.evaluation.tables import markdown
from services.evaluator.statistics import mean_interval, quantile_interval

SAMPLES = 1000
# From here on the planner raises its share of uniform samples.
HIGH = 0.95
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Kind:
    """One way to be unlike the training.

    Args:
        name: in the table.
        scenario: what becomes of a scenario.
        picture: what becomes of its picture.
    """

    name: str
    scenario: Callable[[Scenario, np.random.Generator], Scenario] = lambda scenario, _: scenario
    picture: Callable[[Picture, np.random.Generator], Picture] = lambda image, _: image


def more_discs(count: int) -> Callable[[Scenario, np.random.Generator], Scenario]:
    def change(scenario: Scenario, rng: np.random.Generator) -> Scenario:
        drawn = [disc for _ in range(1 + count // 3) for disc in random_scenario(rng, scenario.robot).discs]
        return replace(scenario, discs=scenario.discs + tuple(drawn[:count]))

    return change


def radius(radius_m: float) -> Callable[[Scenario, np.random.Generator], Scenario]:
    def change(scenario: Scenario, _: np.random.Generator) -> Scenario:
        return replace(scenario, discs=tuple(Disc(one.x_m, one.y_m, radius_m) for one in scenario.discs))

    return change


def without_discs(scenario: Scenario, _: np.random.Generator) -> Scenario:
    return replace(scenario, discs=())


def closer_camera(scenario: Scenario, _: np.random.Generator) -> Scenario:
    return replace(scenario, camera=Camera(-4.0, 4.0, -4.0, 4.0))


def noisy(image: Picture, rng: np.random.Generator) -> Picture:
    return np.clip(image + rng.normal(0.0, 20.0, image.shape), 0, 255).astype(np.uint8)


def blurred(image: Picture, _: np.random.Generator) -> Picture:
    return np.asarray(Image.fromarray(image).filter(ImageFilter.GaussianBlur(1.0)))


def darker(image: Picture, _: np.random.Generator) -> Picture:
    return (image * 0.7).astype(np.uint8)


def other_colours(image: Picture, _: np.random.Generator) -> Picture:
    return np.ascontiguousarray(image[:, :, ::-1])


KINDS = (
    Kind("as in the training"),
    Kind("one disc more", more_discs(1)),
    Kind("three discs more", more_discs(3)),
    Kind("no disc", without_discs),
    Kind("discs of 0.8 m", radius(0.8)),
    Kind("discs of 0.5 m", radius(0.5)),
    Kind("discs of 1.3 m", radius(1.3)),
    Kind("a camera that is closer", closer_camera),
    Kind("noise of 20 of 255", picture=noisy),
    Kind("blurred by 1 pixel", picture=blurred),
    Kind("30 % darker", picture=darker),
    Kind("red and blue exchanged", picture=other_colours),
)


def precision(bundle: Bundle, scenario: Scenario, image: Picture, seed: int, least: float | None) -> float:
    samples = bundle.sample(image, SAMPLES, seed, min_confidence=least).samples
    return float(CollisionChecker(scenario).valid_batch(samples.astype(np.float64)).mean())


def row_of(bundle: Bundle, kind: Kind, scenarios: int) -> list[str]:
    told, alone, served = [], [], []
    for index in range(scenarios):
        rng = scenario_rng(Split.TEST, 0, index)
        scenario = kind.scenario(random_scenario(rng, bundle.spec.world.body), rng)
        shown = kind.picture(render(scenario), rng)
        told.append(bundle.prepare(shown).novelty)
        alone.append(precision(bundle, scenario, shown, index, 0.0))
        served.append(precision(bundle, scenario, shown, index, None))
    rng = np.random.default_rng(0)
    judged = [f"{mean_interval(values, rng):.3f}" for values in (alone, served)]
    high = mean_interval([value > HIGH for value in told], rng)
    return [kind.name, f"{quantile_interval(told, 0.5, rng):.2f}", f"{high:.2f}", *judged]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--scenarios", type=int, default=100)
    options = parser.parse_args()
    bundle = Bundle.load(options.bundle)
    head = ["pictures", "novelty, median", f"above {HIGH}", "precision alone", "precision as served"]
    rows = [row_of(bundle, kind, options.scenarios) for kind in KINDS]
    print(f"{options.bundle}, {options.scenarios} test scenarios; {machine()}\n\n{markdown([head, *rows])}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
