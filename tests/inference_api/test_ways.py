"""``POST /sample`` of a model that searches for ways: samples in their order, each with its way."""

import json

import numpy as np
import pytest

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from tests.bundles import write_tiny_bundle
from tests.inference_api.conftest import CountingRegistry, api_over, stock

WORLD = examples()["two-link"]
PROBLEM = simulator_of(WORLD).problem("uniform", Split.VALIDATION, 0, 0)
PNG = encode_png(simulator_of(WORLD).render(PROBLEM.scenario))
MODEL = "path-sampler@champion"
FIELDS = {
    "start": json.dumps(list(PROBLEM.start)),
    "goal": json.dumps(list(PROBLEM.goal)),
    "n": "50",
    "seed": "4",
    "model": MODEL,
}


@pytest.fixture(scope="module")
def api(bundles, tmp_path_factory):
    place = tmp_path_factory.mktemp("api")
    folder = write_tiny_bundle(place / "ways", kind="path", model_kind="ways", validity=True)
    registry = stock(CountingRegistry(place / "registry"), bundles)
    registry.add(folder, "champion", name="path-sampler")
    with api_over(place, bundles, registry) as found:
        yield found


def ask(api, headers=None, **fields):
    return api.post("/sample", files={"image": PNG}, data={**FIELDS, **fields}, headers=headers)


def test_samples_come_in_the_order_of_the_ways_and_say_which(api):
    answer = ask(api).json()
    assert len(answer["samples"]) == len(answer["ways"]) == len(answer["confidence"]) == 50
    assert np.allclose(answer["samples"][0], PROBLEM.start, atol=1e-6)
    assert answer["ways"][0] == 0
    assert max(answer["ways"]) > 0
    assert ask(api).json()["samples"] == answer["samples"]


def test_the_ways_keep_clear_of_known_discs(api):
    plain = np.array(ask(api).json()["samples"])
    # On the first way, between its ends.
    x_m, y_m = WORLD.body.joint_positions_m(plain[6:7])[0, -1].tolist()
    disc = {"x_m": x_m, "y_m": y_m, "radius_m": 0.1}
    checker = CollisionChecker(Scenario(WORLD.body, (Disc(**disc),)))
    assert not checker.valid_batch(plain).all()
    answer = ask(api, scene=json.dumps([{"name": "pole", "disc": disc}])).json()
    assert len(answer["samples"]) == len(answer["ways"]) == 50
    assert checker.valid_batch(answer["samples"]).all()
