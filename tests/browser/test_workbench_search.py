"""Planners that grow trees in the workbench: what they are asked, what is drawn, and what a refusal says."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.browser.workbench import SCENE, checker, hash_of, is_page, open_bench
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.slow]

ENDS = {"start": "0,0.3", "goal": "-2.6,-0.6"}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with api_server(tmp_path_factory.mktemp("bench"), {"CSPACE_API_WORKBENCH": "1"}) as found:
        body = {"discs": [], "start": [0, 0], "goal": [1, 1], "planner": "RRTConnect"}
        httpx.post(f"{found}/workbench/search", json=body, timeout=60).raise_for_status()
        yield found


def grow(page: Page) -> tuple[dict[str, Any], dict[str, Any]]:
    """Plan by trees: what was asked, and the answer."""
    with page.expect_response(is_page("workbench/search"), timeout=90_000) as answer:
        page.get_by_role("button", name="Plan a path").click()
    found: dict[str, Any] = answer.value.json()
    return json.loads(answer.value.request.post_data or ""), found


@pytest.mark.parametrize("planner", ["RRTConnect", "RRT"])
def test_trees_are_fed_with_the_samples_that_are_shown_and_drawn_with_their_way(
    page: Page, address: str, planner: str
) -> None:
    open_bench(page, address, hash_of(SCENE, **ENDS))
    expect(page.locator("#grown")).to_be_hidden()
    page.locator("#planner").select_option(planner)
    expect(page.locator("#predicted")).to_be_hidden()
    page.get_by_label("iterations").fill("3000")
    page.wait_for_url(re.compile(f"search={planner},shown,3000"))
    request, found = grow(page)
    assert (request["planner"], request["max_iterations"], request["seed"]) == (planner, 3000, "7")
    assert len(request["samples"]) == 300
    assert found["status"] == "solved"
    path = np.array(found["path"])
    assert checker(SCENE).edge_batch(path[:-1], path[1:], 0.002).all()
    expect(page.locator("#plan-status")).to_contain_text(f"{found['iterations']} iterations.")
    expect(page.locator("#plan-status")).to_contain_text("Checked against the discs: collision-free.")
    expect(page.locator("#plan-confidence")).to_contain_text(f"{found['state_checks']} states checked")
    drawn = page.locator("#torus .tree").get_attribute("d") or ""
    # A branch that crosses a seam is drawn at both sides of it.
    assert drawn.count("M") >= sum(parent >= 0 for parent in found["parents"]) > 0
    expect(page.locator("#torus .path")).to_have_attribute("d", re.compile("^M"))
    # Other samples would grow another tree.
    page.locator("#seed").fill("8")
    expect(page.locator("#torus .tree")).to_have_attribute("d", "")
    expect(page.locator("#plan-status")).to_be_empty()


def test_trees_about_the_model_s_plan_ask_for_it_first_and_the_address_keeps_the_choice(
    page: Page, address: str
) -> None:
    open_bench(page, address, f"{hash_of(SCENE, **ENDS)}&search=RRT,ways,500")
    with page.expect_response(is_page("plan"), timeout=90_000) as planned:
        request, found = grow(page)
    assert planned.value.json()["status"] == "solved"
    assert json.loads(planned.value.request.post_data or "")["min_confidence"] == 0
    alternatives = [one["path"] for one in planned.value.json()["alternatives"]]
    assert request["paths"] == alternatives[:8]
    assert (request["planner"], request["max_iterations"]) == ("RRT", 500)
    assert found["learned_drawn"] > 0


def test_a_budget_that_is_used_up_and_an_end_that_collides_are_told(page: Page, address: str) -> None:
    open_bench(page, address, f"{hash_of(SCENE, **ENDS)}&search=RRT,uniform,1")
    grow(page)
    expect(page.locator("#plan-status")).to_have_text("Not solved: no path was found within 1 iterations.")
    expect(page.locator("#plan-status")).to_have_class("bad")
    open_bench(page, address, f"{hash_of([(2.5, 0.0, 1.0)], start='0,0', goal='2,0')}&search=RRT,uniform,1")
    grow(page)
    expect(page.locator("#plan-status")).to_have_text("Refused: the start collides.")


def test_what_a_plan_has_to_score_is_chosen_kept_in_the_address_and_a_refusal_tells_why(
    page: Page, address: str
) -> None:
    open_bench(page, address, hash_of([(2.5, 0.0, 1.0)], start="2.4,0.3", goal="0.45,0"))
    page.get_by_label("Plan", exact=True).get_by_label("minimum confidence").select_option("0.99")
    page.wait_for_url(re.compile("plan=7,5,4,0.99"))
    with page.expect_response(is_page("plan"), timeout=90_000) as answer:
        page.get_by_role("button", name="Plan a path").click()
    assert json.loads(answer.value.request.post_data or "")["min_confidence"] == 0.99
    plan = answer.value.json()
    assert plan["status"] == "refused"
    assert "below the requested 0.99" in plan["reason"]
    expect(page.locator("#plan-status")).to_have_text(f"Refused: {plan['reason']}.")
    again = page.url.partition("/#")[2]
    open_bench(page, address, f"#{again}")
    expect(page.locator("#plan-min-confidence")).to_have_value("0.99")


def test_a_server_without_the_truth_offers_no_trees(page: Page, tmp_path: Path) -> None:
    with api_server(tmp_path, {}) as bare:
        open_bench(page, bare, f"{hash_of(SCENE, **ENDS)}&search=RRT,uniform,100")
        expect(page.locator("#planner-label")).to_be_hidden()
        with page.expect_response(is_page("plan"), timeout=90_000):
            page.get_by_role("button", name="Plan a path").click()
        page.goto("about:blank")
