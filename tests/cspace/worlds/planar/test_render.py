import numpy as np
import pytest
from PIL import Image, ImageDraw

from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Disc, Scenario
from tests.scenarios import random_scenarios

WHITE, RED, BLUE = (255, 255, 255), (255, 0, 0), (0, 0, 255)
FINE = 16


def drawn_by_pillow(scenario):
    """Another program's picture to the same description: shapes at 16 times the size, then averaged."""
    camera, robot = scenario.camera, scenario.robot
    side = camera.pixels * FINE
    scale = side / (camera.x_max_m - camera.x_min_m)
    picture = Image.new("RGB", (side, side), WHITE)
    draw = ImageDraw.Draw(picture)

    def at(x_m, y_m):
        return (x_m - camera.x_min_m) * scale, (camera.y_max_m - y_m) * scale

    def disc(x_m, y_m, radius_m, colour):
        x, y = at(x_m, y_m)
        radius = radius_m * scale
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)

    width = robot.half_width_m
    (left, top), (right, bottom) = at(0.0, width), at(sum(robot.link_lengths_m), -width)
    draw.rectangle((left, top, right, bottom), fill=BLUE)
    disc(0.0, 0.0, width, BLUE)
    disc(sum(robot.link_lengths_m), 0.0, width, BLUE)
    for one in scenario.discs:
        disc(one.x_m, one.y_m, one.radius_m, RED)
    return np.asarray(picture.reduce(FINE))


@pytest.mark.parametrize("scenario", random_scenarios(Split.DEMO, 3, 3), ids=str)
def test_a_picture_drawn_by_another_program_agrees(scenario):
    ours, theirs = render(scenario).astype(int), drawn_by_pillow(scenario).astype(int)
    # An outline of a sixteenth of a pixel, on the rims only.
    assert np.abs(ours - theirs).max() <= 40
    assert np.abs(ours - theirs).mean() < 0.6


def test_colours_are_exact_away_from_outlines():
    # Pixel (row, column) covers x from -5 + column / 4.8 and y below 5 - row / 4.8.
    picture = render(Scenario(TWO_LINK, (Disc(-3.0, 3.0),)))
    assert picture.dtype == np.uint8
    assert picture.shape == (48, 48, 3)
    assert tuple(picture[9, 9]) == RED
    assert tuple(picture[0, 47]) == WHITE
    assert set(map(tuple, picture[40])) == {WHITE}
