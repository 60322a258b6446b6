"""What a plan in the workbench is asked with, and what is told of how sure it is."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.browser import workbench
from tests.browser.workbench import SCENE, bench_server, hash_of, is_page, open_bench
from tests.bundles import write_tiny_bundle
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.slow]

ENDS = {"start": "0,0.3", "goal": "-2.6,-0.6"}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with bench_server(tmp_path_factory.mktemp("bench")) as found:
        yield found


def plan(page: Page) -> tuple[dict[str, Any], dict[str, Any]]:
    """Plan a path: what was asked, and the answer."""
    with page.expect_response(is_page("plan")) as answer:
        page.get_by_role("button", name="Plan a path").click()
    found: dict[str, Any] = answer.value.json()
    return json.loads(answer.value.request.post_data or ""), found


def test_seed_time_and_number_of_ways_are_asked_for_and_stand_in_the_address(
    page: Page, address: str
) -> None:
    open_bench(page, address, hash_of(SCENE, **ENDS))
    request, _ = plan(page)
    assert (request["seed"], request["time_limit_s"], request["ways"]) == ("7", 5, 4)
    expect(page.locator("#plan-status")).to_contain_text("Checked")
    fields = page.get_by_label("Plan", exact=True)
    fields.get_by_label("paths", exact=True).fill("2")
    # Another question: the way that was there is none of its answers.
    expect(page.locator("#plan-status")).to_be_empty()
    fields.get_by_label("seed").fill("18446744073709551615")
    fields.get_by_label("time limit, s").fill("1.5")
    page.wait_for_url(re.compile("plan=18446744073709551615,1.5,2"))
    request, found = plan(page)
    assert (request["seed"], request["time_limit_s"], request["ways"]) == ("18446744073709551615", 1.5, 2)
    assert found["seed"] == "18446744073709551615"
    again = page.url.partition("/#")[2]
    open_bench(page, address, f"#{again}")
    expect(fields.get_by_label("paths", exact=True)).to_have_value("2")
    expect(fields.get_by_label("time limit, s")).to_have_value("1.5")


@pytest.mark.parametrize("wrong", ["plan=x,0,99", "plan=", "plan=1,2,3,4;", "plan=-1,99,0.2"])
def test_what_an_address_says_wrongly_of_a_plan_is_brought_within_its_bounds(
    page: Page, address: str, wrong: str
) -> None:
    open_bench(page, address, f"{hash_of(SCENE, **ENDS)}&{wrong}")
    request, found = plan(page)
    # A machine that has much to do finds nothing in the least time.
    assert found["status"] == "solved" or request["time_limit_s"] == 0.01
    assert 0.01 <= request["time_limit_s"] <= 10
    assert 1 <= request["ways"] <= 64


def test_the_least_sure_place_and_each_piece_of_a_way_are_told_and_drawn(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE, **ENDS))
    _, found = plan(page)
    assert found["status"] == "solved"
    least, edges = found["least_sure"], found["edges"]
    note = page.locator("#plan-confidence")
    expect(note).to_contain_text(f"Lowest confidence {least['confidence']:.3f} after")
    pieces = re.search(r"Per edge: ([\d., ]+)\.$", note.inner_text())
    assert pieces is not None
    assert np.allclose([float(one) for one in pieces[1].split(", ")], edges, atol=0.00051)
    # As sure as this it needs no mark.
    assert least["confidence"] > 0.99
    expect(page.locator("#torus .least")).to_be_hidden()
    uncertain = (page.locator("#torus .uncertain").get_attribute("d") or "").count("M")
    assert (uncertain > 0) == any(edge < 0.9 for edge in edges)
    # The confidence goes with the path.
    page.get_by_role("button", name="Add a disc").click()
    expect(note).to_be_empty()


def test_pieces_of_little_confidence_are_drawn_as_such(page: Page, tmp_path: Path) -> None:
    # Its head likes joints near 0 rad, and its plans are not calibrated: nothing is refused.
    bundle = write_tiny_bundle(tmp_path / "bundle", validity=True)
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundle), "CSPACE_API_WORKBENCH": "1"}
    with api_server(tmp_path, settings) as own:
        open_bench(page, own, hash_of([], start="0,0.3", goal="2.6,1.5"))
        _, found = plan(page)
        assert all(edge < 0.9 for edge in found["edges"])
        expect(page.locator("#plan-confidence")).to_contain_text("Per edge")
        drawn = [page.locator(f"#torus .{kind}").get_attribute("d") for kind in ("path", "uncertain")]
        assert drawn[0]
        assert drawn[0] == drawn[1]
        mark = page.locator("#torus .least")
        x, y = (float(mark.get_attribute(name) or "nan") for name in ("cx", "cy"))
        turn = 2.0 * np.pi
        place = (x / workbench.SIDE * turn - np.pi, (1.0 - y / workbench.SIDE) * turn - np.pi)
        assert np.allclose(place, found["least_sure"]["configuration"], atol=1e-3)
        expect(page.locator("#scene .arm.least")).to_have_attribute("d", re.compile("^M"))
        page.goto("about:blank")


def test_a_refusal_tells_its_reason(page: Page, address: str) -> None:
    open_bench(page, address, hash_of([(2.5, 0.0, 1.0)], start="2,0.3", goal="0,0"))
    _, found = plan(page)
    assert (found["status"], found["least_sure"]) == ("refused", None)
    expect(page.locator("#plan-status")).to_have_text(f"Refused: {found['reason']}.")
    expect(page.locator("#plan-status")).to_have_class("bad")
    expect(page.locator("#plan-confidence")).to_be_empty()
    expect(page.get_by_role("button", name="Play")).to_be_disabled()


def test_a_refused_path_shows_where_its_confidence_is_lowest(page: Page, address: str) -> None:
    open_bench(page, address, hash_of([(2.5, 0.0, 1.0)], start="2.4,0.3", goal="0.45,0"))
    # As models whose plans are calibrated have it without being asked.
    page.route(
        "**/plan",
        lambda route: route.continue_(
            post_data=json.dumps({**route.request.post_data_json, "min_confidence": 0.9})
        ),
    )
    _, found = plan(page)
    page.unroute("**/plan")
    assert found["status"] == "refused"
    expect(page.locator("#plan-status")).to_have_text(f"Refused: {found['reason']}.")
    expect(page.locator("#plan-confidence")).to_contain_text(
        f"Lowest confidence {found['least_sure']['confidence']:.3f}"
    )
    expect(page.locator("#torus .least")).to_be_visible()
    expect(page.locator("#torus .path")).to_have_attribute("d", "")
