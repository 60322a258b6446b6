"""The workbench's view of an arm in space, held against the spatial world's own code."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from tests.browser.workbench import is_page
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(300)]

FAMILY, SEED = "table", 2
FRAGMENT = f"#view=space&family={FAMILY}&scene={SEED}"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with api_server(tmp_path_factory.mktemp("bench"), {"CSPACE_API_WORKBENCH": "1"}) as found:
        body = {"model": "pretrained-panda", "family": FAMILY, "seed": SEED}
        httpx.post(f"{found}/workbench/space", json=body, timeout=120).raise_for_status()
        yield found


def open_space(page: Page, address: str, fragment: str = FRAGMENT) -> dict[str, Any]:
    page.goto("about:blank")
    with page.expect_response(is_page("sample")) as samples:
        page.goto(f"{address}/{fragment}")
    found: dict[str, Any] = samples.value.json()
    settle(page)
    return found


def settle(page: Page) -> None:
    expect(page.locator("#space-drawing")).to_have_attribute("aria-busy", "false")


def numbers(page: Page) -> dict[str, str]:
    terms = page.locator("#space-numbers dt").all_inner_texts()
    return dict(zip(terms, page.locator("#space-numbers dd").all_inner_texts(), strict=True))


def test_turning_a_camera_moves_the_doubt(page: Page, address: str) -> None:
    before = open_space(page, address)
    shown = numbers(page)
    pictures = page.get_by_role("img", name=re.compile("^Depth picture"))
    expect(pictures).to_have_count(len(simulator().problem(FAMILY, Split.DEMO, SEED).scenario.cameras))
    with page.expect_response(is_page("sample")) as samples:
        page.get_by_role("slider", name="side").press("ArrowRight")
    settle(page)
    expect(pictures).to_have_count(1)
    after = samples.value.json()
    assert after["unseen"] != before["unseen"]
    assert numbers(page) != shown
    expect(page.locator("#camera-count")).to_have_value("1")
    page.wait_for_url(re.compile("cameras=1,41,35,1.2"))


def test_the_figures_are_those_of_the_samples_and_of_the_scene_s_checks(page: Page, address: str) -> None:
    answer = open_space(page, address)
    checker = simulator().checker(simulator().problem(FAMILY, Split.DEMO, SEED).scenario)
    free = checker.valid_batch(np.array(answer["samples"]))
    assert numbers(page) == {
        "believed free": f"{100 * np.mean(answer['confidence']):.0f} %",
        "free in truth": f"{100 * np.mean(free):.0f} %",
        "of the arm unseen": f"{100 * np.mean(answer['unseen']):.0f} %",
    }


def test_a_way_is_planned_checked_and_played(page: Page, address: str) -> None:
    open_space(page, address)
    with page.expect_response(is_page("plan"), timeout=120_000) as planned:
        page.get_by_role("button", name="Plan a way").click()
    answer = planned.value.json()
    assert answer["status"] == "solved", answer["reason"]
    way = np.array(answer["path"])
    checker = simulator().checker(simulator().problem(FAMILY, Split.DEMO, SEED).scenario)
    free = checker.edge_batch(way[:-1], way[1:], 0.005)
    verdict = "it is free" if free.all() else f"it collides on {(~free).sum()} of {len(free)} pieces"
    expect(page.locator("#space-told")).to_contain_text(f"Checked against the obstacles: {verdict}.")
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    page.get_by_role("slider", name="Along the way").press("Home")
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    page.get_by_role("slider", name="joint 1").press("ArrowLeft")
    expect(page.locator("#space-told")).to_be_empty()


def test_the_arm_that_the_cameras_see_stands_at_the_start_and_the_address_keeps_it(
    page: Page, address: str
) -> None:
    open_space(page, address)
    page.get_by_label("sliders move").select_option("start")
    with page.expect_response(is_page("space")) as moved:
        page.get_by_role("slider", name="joint 1").press("ArrowRight")
    settle(page)
    start = moved.value.json()["start"]
    problem = simulator().problem(FAMILY, Split.DEMO, SEED)
    assert start[0] > problem.start[0]
    assert np.allclose(start[1:], problem.start[1:])
    page.wait_for_url(re.compile(f"from={start[0]:.3f}"[:-1]))
    fragment = page.url[page.url.index("#") :]
    with page.expect_response(is_page("space")) as again:
        open_space(page, address, fragment)
    assert np.allclose(again.value.json()["start"], start, atol=1e-3)


def test_what_is_copied_runs_and_asks_for_the_same(page: Page, address: str, tmp_path: Path) -> None:
    shown = open_space(page, address)
    page.get_by_role("button", name="Copy as Python").click()
    expect(page.locator("#take-told")).not_to_be_empty()
    text = page.locator("#take-text").input_value()
    command = [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120)
    assert json.loads(done.stdout) == shown["samples"]


def test_the_arm_is_drawn_where_its_kinematics_have_it(page: Page, address: str) -> None:
    open_space(page, address)
    arm = examples()["panda"].body
    rows = arm.space.sample_uniform(np.random.default_rng(0), 4)
    found = page.evaluate(
        """async ([arm, rows]) => {
            const solid = await import("/workbench/files/solid.js");
            return rows.map((row) => solid.frames(arm, row));
        }""",
        [arm.to_dict(), rows.tolist()],
    )
    frames = np.concatenate([arm.link_frames(rows), arm.tool_frames(rows)[:, None]], axis=1)  # type: ignore[attr-defined]
    assert np.allclose(found, frames, atol=1e-9)


def test_a_server_without_the_truth_says_what_the_view_needs(
    page: Page, tmp_path_factory: pytest.TempPathFactory
) -> None:
    with api_server(tmp_path_factory.mktemp("plain"), {}) as plain:
        page.goto(f"{plain}/{FRAGMENT}")
        expect(page.locator("#space-none")).to_contain_text("--workbench")
        expect(page.locator("#space-body")).to_be_hidden()
        page.goto("about:blank")


def simulator() -> Any:
    return simulator_of(examples()["panda"])
