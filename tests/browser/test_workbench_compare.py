"""Two models beside each other on the same problem, as a person compares them."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, Request, Response, expect

from tests.browser import workbench
from tests.browser.workbench import drag, hash_of, open_bench, place_of, settle, shown_samples
from tests.bundles import write_tiny_bundle
from tests.contracts.mlflow_server import mlflow_server
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.slow]

SCENE: workbench.Discs = [(2.6, 1.9, 1.0), (-1.9, 2.5, 1.0), (0.5, -3.2, 1.0)]
VERSION = "cspace-sampler/1"
BESIDE = {"model": "pretrained", "beside": VERSION}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server on the shipped model and on a registry of its own with one version, with the truth."""
    folder = tmp_path_factory.mktemp("bench")
    bundle = write_tiny_bundle(folder / "bundle", validity=True)
    command = [sys.executable, "-m", "services.registry", "models", "import", str(bundle), "cspace-sampler"]
    with (
        mlflow_server(tmp_path_factory.mktemp("mlflow")) as server,
        api_server(folder, {"CSPACE_API_WORKBENCH": "1", "MLFLOW_TRACKING_URI": server}) as found,
    ):
        subprocess.run(command, check=True, env={**os.environ, "MLFLOW_TRACKING_URI": server}, timeout=100)
        body = {"discs": [], "path": [[0, 0], [1, 1]]}
        httpx.post(f"{found}/workbench/truth", json=body, timeout=60).raise_for_status()
        httpx.post(f"{found}/workbench/truth", json={**body, "model": VERSION}, timeout=60).raise_for_status()
        yield found


def rows(page: Page) -> dict[str, list[str]]:
    """The table of figures: its names, and a value for each model."""
    found: dict[str, list[str]] = {}
    for row in page.locator("#compared tbody tr").all():
        found[row.locator("th").inner_text()] = row.locator("td").all_inner_texts()
    return found


def test_a_version_of_the_registry_is_chosen_beside_the_one_that_ships_and_asked_for_the_same(
    page: Page, address: str
) -> None:
    open_bench(page, address, hash_of(SCENE, model="pretrained"))
    expect(page.get_by_role("table")).to_be_hidden()
    requests: list[Any] = []

    def keep(request: Request) -> None:
        if request.url.endswith("/sample"):
            requests.append(request.post_data_json)

    page.on("request", keep)
    page.get_by_role("combobox", name="compare with").select_option(VERSION)
    expect(page.get_by_role("table")).to_contain_text(VERSION)
    page.wait_for_url(re.compile("beside=cspace-sampler/1"))
    settle(page)
    page.remove_listener("request", keep)
    last = {body["model"]: body for body in requests}
    assert last["pretrained"].keys() == last[VERSION].keys()
    assert {**last["pretrained"], "model": VERSION} == last[VERSION]
    both = [shown_samples(page, one) for one in ("#torus", "#torus-beside")]
    assert [len(one) for one in both] == [300, 300]
    assert not np.allclose(both[0], both[1])
    page.get_by_role("combobox", name="compare with").select_option("")
    expect(page.locator("#torus-beside")).to_be_hidden()
    expect(page.locator("#numbers")).to_be_visible()


def test_figures_of_two_models_are_those_of_the_truth_for_each(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE, **BESIDE))
    checks = workbench.checker(SCENE)
    for value in page.locator("#compared tbody tr").first.locator("td").all():
        expect(value).to_contain_text("%")
    table = rows(page)
    for at, drawing in enumerate(("#torus", "#torus-beside")):
        precision = float(table["precision"][at].removesuffix("%"))
        truly = 100.0 * float(np.mean(checks.valid_batch(shown_samples(page, drawing))))
        # Drawings round to a tenth of a pixel.
        assert precision == pytest.approx(truly, abs=1.0)
    assert table["precision"][0] != table["precision"][1]
    assert all(re.fullmatch(r"\d+\.\d ms", value) for value in table["sampled in"])
    assert {"coverage", "accepted", "novelty"} < table.keys()


def test_both_follow_a_disc_that_is_dragged(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE, **BESIDE))
    before = [shown_samples(page, one) for one in ("#torus", "#torus-beside")]
    drag(page, (0.5, -3.2), (1.5, -1.8))
    workbench.wait_for_disc(page, 2, 1.5, -1.8)
    for drawing, old in zip(("#torus", "#torus-beside"), before, strict=True):
        assert not np.array_equal(shown_samples(page, drawing), old)
    box = page.locator("#torus-beside").bounding_box()
    assert box is not None
    assert box["x"] > place_of(page, 5.0, 0.0)[0]


def test_a_plan_asks_both_and_the_table_tells_each_way_and_whether_it_is_free(
    page: Page, address: str
) -> None:
    answers: dict[str, Any] = {}

    def keep(response: Response) -> None:
        if response.url.endswith("/plan"):
            answers[response.request.post_data_json["model"]] = response.json()

    open_bench(page, address, hash_of(SCENE, start="0,0.3", goal="-2.6,-0.6", **BESIDE))
    page.on("response", keep)
    page.get_by_role("button", name="Plan a path").click()
    expect(page.locator("#plan-status")).to_contain_text(f"{VERSION}: ")
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    page.remove_listener("response", keep)
    assert answers.keys() == {"pretrained", VERSION}
    table = rows(page)
    assert table["plan"] == [answers[one]["status"] for one in ("pretrained", VERSION)]
    assert table["confidence"][0] == f"{answers['pretrained']['confidence']:.3f}"
    assert table["collision-free (ground truth)"][0] == "yes"
    for drawing, one in (("#torus", "pretrained"), ("#torus-beside", VERSION)):
        path = answers[one]["path"]
        drawn = page.locator(f"{drawing} .path").get_attribute("d") or ""
        assert drawn.count("M") >= len(path) - 1
    # What changes the problem takes both ways away.
    page.get_by_role("button", name="Add a disc").click()
    expect(page.locator("#torus .path")).to_have_attribute("d", "")
    expect(page.locator("#compared")).not_to_contain_text("collision-free (ground truth)")


def test_the_same_model_twice_and_one_of_another_robot_are_no_comparison(page: Page, address: str) -> None:
    for beside in ("pretrained", "pretrained-panda"):
        open_bench(page, address, hash_of(SCENE, model="pretrained", beside=beside))
        expect(page.get_by_role("table")).to_be_hidden()
        expect(page.get_by_role("combobox", name="compare with")).to_have_value("")
    names = page.get_by_role("combobox", name="compare with").locator("option").all_inner_texts()
    assert names == ["none", f"{VERSION} (challenger)"]
    open_bench(page, address, hash_of(SCENE, model="pretrained", beside="nobody"))
    expect(page.get_by_role("alert")).to_contain_text("nobody")


@pytest.mark.parametrize("size", [(1480, 940), (900, 1100), (390, 844)], ids=str)
def test_two_models_fit_the_window_and_axe_finds_nothing_serious(
    page: Page, address: str, size: tuple[int, int]
) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    open_bench(page, address, hash_of(SCENE, **BESIDE))
    settle(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    tops = [page.locator(one).bounding_box() for one in ("#torus", "#torus-beside")]
    first, second = (box["y"] for box in tops if box is not None)
    assert (first < second) == (size[0] == 390)
    found = Axe().run(page).response["violations"]
    assert [one["id"] for one in found if one["impact"] in ("serious", "critical")] == []
