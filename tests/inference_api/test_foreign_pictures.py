"""Pictures that another program draws to the description in docs/method.md: Pillow, eight times finer."""

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.render import render
from cspace.worlds.planar.world import Scenario
from inference_api.settings import PRETRAINED_FOLDER
from tests.scenarios import random_scenarios

FINER = 8
SCENARIOS = 60
SAMPLES = 400


def drawn_with_pillow(scenario: Scenario) -> NDArray[np.uint8]:
    """White ground, the arm at theta = 0 in blue, the discs over it in red; (P, P, 3)."""
    camera = scenario.camera
    side = camera.pixels * FINER
    scale = side / (camera.x_max_m - camera.x_min_m)
    image = Image.new("RGB", (side, side), (255, 255, 255))
    draw = ImageDraw.Draw(image)

    def ellipse(x: float, y: float, radius: float, colour: tuple[int, int, int]) -> None:
        left, top = (x - radius - camera.x_min_m) * scale, (camera.y_max_m - y - radius) * scale
        # Pillow's boxes hold their last pixel.
        size = 2.0 * radius * scale - 1.0
        draw.ellipse((left, top, left + size, top + size), fill=colour)

    half, reach = scenario.robot.half_width_m, sum(scenario.robot.link_lengths_m)
    blue = (0, 0, 255)
    left, top = -camera.x_min_m * scale, (camera.y_max_m - half) * scale
    draw.rectangle((left, top, left + reach * scale - 1.0, top + 2.0 * half * scale - 1.0), fill=blue)
    ellipse(0.0, 0.0, half, blue)
    ellipse(reach, 0.0, half, blue)
    for disc in scenario.discs:
        ellipse(disc.x_m, disc.y_m, disc.radius_m, (255, 0, 0))
    return np.asarray(image.resize((camera.pixels, camera.pixels), Image.Resampling.BOX))


@pytest.fixture(scope="module")
def scenarios() -> list[Scenario]:
    return random_scenarios(Split.DEMO, 21, SCENARIOS)


def test_they_look_like_the_project_s_own(scenarios: list[Scenario]) -> None:
    gaps = [np.abs(drawn_with_pillow(one).astype(float) - render(one)).mean() for one in scenarios]
    assert max(gaps) < 2.0


def test_the_shipped_model_is_as_precise_on_them(scenarios: list[Scenario]) -> None:
    bundle = Bundle.load(PRETRAINED_FOLDER)
    gains = []
    for index, scenario in enumerate(scenarios):
        free = CollisionChecker(scenario).valid_batch
        foreign, own = (
            free(bundle.sample(picture, SAMPLES, index, min_confidence=0.0).samples).mean()
            for picture in (drawn_with_pillow(scenario), render(scenario))
        )
        gains.append(foreign - own)
    margin = 1.96 * np.std(gains, ddof=1) / np.sqrt(len(gains))
    assert margin < 0.01
    assert abs(np.mean(gains)) < max(margin, 0.005)
