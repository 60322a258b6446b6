"""The workbench as a person uses it, held against the planar world's own checks."""

import base64
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from cspace.png import encode_png
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.render import render
from cspace.worlds.planar.world import Disc, Scenario
from inference_api.keys import digest_of, make_key
from tests.browser import workbench
from tests.browser.workbench import (
    SCENE,
    bench_server,
    checker,
    drag,
    hash_of,
    is_page,
    open_bench,
    settle,
    shown_samples,
    wait_for_disc,
)
from tests.bundles import write_tiny_bundle
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with bench_server(tmp_path_factory.mktemp("bench")) as found:
        yield found


def test_samples_leave_the_shadow_of_a_disc_that_is_dragged(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE))
    before = shown_samples(page)
    assert len(before) == 300
    drag(page, (0.5, -3.2), (1.5, -1.8))
    wait_for_disc(page, 2, 1.5, -1.8)
    moved = checker(workbench.discs_in_address(page))
    shadow = ~moved.valid_batch(before)
    assert np.mean(shadow) > 0.05
    after = shown_samples(page)
    assert len(after) == 300
    assert np.mean(~moved.valid_batch(after)) < 0.02


def test_a_planned_way_is_free_by_an_independent_check_and_is_drawn_in_both_views(
    page: Page, address: str
) -> None:
    open_bench(page, address, hash_of(SCENE, start="0,0.3", goal="-2.6,-0.6"))
    with page.expect_response(is_page("plan")) as answer:
        page.get_by_role("button", name="Plan a path").click()
    plan = answer.value.json()
    assert plan["status"] == "solved", plan["reason"]
    path = np.array(plan["path"])
    assert checker(SCENE).edge_batch(path[:-1], path[1:], 0.005).all()
    expect(page.locator("#plan-status")).to_contain_text("Checked against the discs: collision-free.")
    drawn = page.locator("#torus .path").get_attribute("d") or ""
    assert drawn.count("M") >= len(path) - 1
    assert (page.locator("#scene .arm.ghost").get_attribute("d") or "").count("M") == 14
    # It plays by itself, and stops where one takes hold of it.
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    slider = page.get_by_role("slider", name="Along the path")
    slider.press("End")
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    assert slider.input_value() == "1000"
    # What changes the scene makes the way stale.
    page.get_by_role("button", name="Add a disc").click()
    expect(page.locator("#torus .path")).to_have_attribute("d", "")


def test_the_picture_that_is_sent_is_the_one_that_training_draws(page: Page, address: str) -> None:
    rng = np.random.default_rng(0)
    for count in (0, 1, 3, 12):
        rows = np.round(np.column_stack([rng.uniform(-4, 4, (count, 2)), rng.uniform(0.2, 1.5, count)]), 3)
        discs = [tuple(row) for row in rows.tolist()]
        page.goto("about:blank")
        with page.expect_request("**/sample") as request:
            page.goto(f"{address}/{hash_of(discs)}")
        seen = decode_png(workbench.sent_picture(request.value.post_data), 48)
        assert np.array_equal(seen, render(workbench.scenario(discs)))


def test_a_broken_png_gets_a_useful_message_and_a_good_one_takes_it_away(page: Page, address: str) -> None:
    open_bench(page, address)
    problem = page.get_by_role("alert")
    broken = {"name": "broken.png", "mimeType": "image/png", "buffer": b"\x89PNG nothing of the kind"}
    page.locator("#open").set_input_files(broken)
    expect(problem).to_contain_text("The picture is not acceptable")
    expect(problem).to_contain_text("PNG")
    picture = encode_png(render(workbench.scenario([(1.0, 3.0, 0.8)])))
    with page.expect_request("**/sample") as request:
        page.locator("#open").set_input_files({"name": "own.png", "mimeType": "image/png", "buffer": picture})
    assert workbench.sent_picture(request.value.post_data) == picture
    expect(problem).to_be_hidden()
    expect(page.locator("#disc-status")).to_have_text("uploaded picture, no discs")
    page.get_by_role("button", name="Back to discs").click()
    expect(page.locator("#disc-status")).to_have_text("no disc selected")


def test_figures_say_what_they_mean_and_a_high_novelty_warns(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE))
    novelty = page.locator("#numbers [data-name=novelty]")
    usual = novelty.locator("dd").evaluate("(one) => getComputedStyle(one).color")
    for name in ("accepted", "novelty", "shortfall"):
        assert len(page.locator(f"#numbers [data-name={name}]").get_attribute("title") or "") > 20
    noise = encode_png(np.random.default_rng(0).integers(0, 256, (48, 48)).astype(np.uint8))
    with page.expect_response(is_page("sample")):
        page.locator("#open").set_input_files({"name": "noise.png", "mimeType": "image/png", "buffer": noise})
    expect(novelty).to_have_class("warning")
    assert novelty.locator("dd").evaluate("(one) => getComputedStyle(one).color") != usual


def test_an_api_that_is_away_is_told_and_what_was_changed_meanwhile_is_shown_when_it_is_back(
    page: Page, address: str
) -> None:
    open_bench(page, address, hash_of(SCENE))
    cut = "**/{sample,health/live,workbench/*,models}"
    page.route(cut, lambda route: route.abort("connectionrefused"))
    drag(page, (0.5, -3.2), (1.5, -1.8))
    expect(page.locator("#connection")).to_have_text("The API is not reachable; retrying")
    with page.expect_response(is_page("truth")):
        page.unroute(cut)
    expect(page.locator("#connection")).to_contain_text("300 samples")
    settle(page)
    moved = checker(workbench.discs_in_address(page))
    assert np.mean(~moved.valid_batch(shown_samples(page))) < 0.02


def test_the_page_measures_from_an_interaction_to_its_samples(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE))
    page.evaluate("() => performance.clearMeasures()")
    x, y, _ = workbench.discs_in_address(page)[2]
    drag(page, (x, y), (1.5, -1.8), steps=20)
    wait_for_disc(page, 2, 1.5, -1.8)
    durations = "() => performance.getEntriesByName('interaction-to-samples').map((one) => one.duration)"
    assert len(page.evaluate(durations)) >= 5


def test_an_address_opens_the_same_scene_again(page: Page, address: str) -> None:
    first = open_bench(page, address, hash_of(SCENE, seed="11", n="50", start="1,0.5"))
    page.get_by_role("button", name="Add a disc").click()
    expect(page.get_by_role("button", name="Disc 4")).to_be_visible()
    page.wait_for_url(re.compile(r"discs=([^;&]*;){3}"))
    settle(page)
    shown = shown_samples(page)
    again = open_bench(page, address, page.url.partition("/#")[2].join(("#", "")))
    assert (again["seed"], len(again["samples"])) == ("11", 50) == (first["seed"], len(first["samples"]))
    assert np.allclose(shown_samples(page), shown)
    expect(page.get_by_role("button", name="Disc 4")).to_be_visible()


@pytest.mark.parametrize("form", ["curl", "Python"])
@pytest.mark.parametrize("what", ["sample", "plan"])
def test_what_is_copied_runs_and_asks_for_the_same(
    page: Page, address: str, form: str, what: str, tmp_path: Path
) -> None:
    shown = open_bench(page, address, hash_of(SCENE, n="5"))
    page.locator("#take-what").select_option(what)
    page.get_by_role("button", name=f"Copy as {form}").click()
    expect(page.locator("#take-status")).not_to_be_empty()
    text = page.locator("#take-text").input_value()
    command = ["bash", "-c", text] if form == "curl" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60)
    if what == "plan":
        assert "solved" in done.stdout
    else:
        rows = done.stdout.partition('"samples":')[2].partition('"confidence"')[0] or done.stdout
        numbers = [float(one) for one in re.findall(r"-?\d+\.\d+", rows)]
        assert numbers[:10] == [angle for row in shown["samples"] for angle in row]


def test_a_family_draws_its_scene_and_its_problem_by_a_seed(page: Page, address: str) -> None:
    open_bench(page, address)
    expect(page.locator("#family option")).to_have_count(3)
    page.locator("#family").select_option("narrow")
    page.locator("#family-seed").fill("24")
    with page.expect_response(is_page("scene")) as answer:
        page.get_by_role("button", name="Generate a scene").click()
    page.wait_for_url(re.compile(f"discs={answer.value.json()['discs'][0][0]:.3f}"))
    expect(page.get_by_role("button", name=re.compile("^Start: joint 1"))).to_be_visible()


def test_a_server_without_the_truth_still_shows_pictures_samples_and_plans(
    page: Page, tmp_path: Path
) -> None:
    with api_server(tmp_path, {}) as plain:
        open_bench(page, plain, hash_of(SCENE))
        assert len(shown_samples(page)) == 300
        expect(page.get_by_role("button", name="Generate a scene")).to_be_hidden()
        expect(page.locator("#numbers")).not_to_contain_text("precision")
        page.get_by_label("background").select_option("prediction")
        expect(page.locator(".ground-3").first).to_have_attribute("d", re.compile("^M"))
        page.get_by_role("button", name="Plan a path").click()
        expect(page.locator("#plan-status")).to_contain_text("Solved")
        expect(page.locator("#plan-status")).not_to_contain_text("Checked")
        page.goto("about:blank")


def test_a_key_is_asked_for_and_kept_in_memory_alone(page: Page, tmp_path: Path) -> None:
    key = make_key()
    keys = tmp_path / "keys"
    keys.write_text(f"bench:{digest_of(key)}\n")
    keys.chmod(0o600)
    with api_server(tmp_path, {"CSPACE_API_KEYS_FILE": str(keys)}) as locked:
        page.goto(f"{locked}/")
        expect(page.get_by_role("alert")).to_contain_text("A key is needed")
        page.get_by_label("API key").fill("wrong")
        page.get_by_role("button", name="Use the key").click()
        expect(page.get_by_role("alert")).to_contain_text("an unknown key")
        page.get_by_label("API key").fill(key)
        page.get_by_role("button", name="Use the key").click()
        expect(page.locator("#connection")).to_contain_text("300 samples")
        expect(page.get_by_role("alert")).to_be_hidden()
        kept = page.evaluate(
            "() => JSON.stringify([{...localStorage}, {...sessionStorage}, document.cookie])"
        )
        assert key not in kept
        assert key not in page.url
        page.goto("about:blank")


def test_models_are_listed_with_where_they_come_from_and_can_be_chosen(page: Page, address: str) -> None:
    open_bench(page, address)
    page.get_by_role("button", name="Models").click()
    card = page.get_by_role("article").filter(has_text="pretrained").first
    expect(card).to_contain_text("training/cluster_train.py")
    expect(card).to_contain_text("default")
    with page.expect_response(is_page("sample")) as answer:
        card.get_by_role("button", name="Use pretrained").click()
    assert answer.value.json()["model"]["name"] == "pretrained"
    expect(page.locator("#scene")).to_be_visible()
    page.wait_for_url(re.compile("model=pretrained"))


def test_an_arm_of_three_joints_with_limits_has_a_map_of_two_and_sliders_for_all(
    page: Page, tmp_path: Path
) -> None:
    arm = PlanarArm((1.6, 1.4, 1.0), joint_limits_rad=((-1.0, 2.0), None, (-0.5, 0.5)))
    bundle = write_tiny_bundle(tmp_path / "bundle", arm, validity=True)
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundle), "CSPACE_API_WORKBENCH": "1"}
    with api_server(tmp_path, settings) as own:
        # What an earlier page still waits for is no answer to this one.
        page.goto("about:blank")
        with page.expect_response(is_page("truth")) as response:
            answer = open_bench(page, own, hash_of(SCENE, start="0.5,1,0.4", goal="9,9,9", n="20"))
        truth = response.value.json()
        assert len(answer["samples"][0]) == 3
        expect(page.locator("#joints input")).to_have_count(6)
        # Limits stop what leaves them, circles wrap it.
        page.wait_for_url(re.compile(r"goal=2,2.717,0.5"))
        checks = CollisionChecker(Scenario(arm, tuple(Disc(*disc) for disc in SCENE)))
        assert truth["sample_free"] == checks.valid_batch(answer["samples"]).tolist()
        cells = truth["cells"]
        first = -1.0 + 3.0 * (np.arange(cells) + 0.5) / cells
        second = -np.pi + 2.0 * np.pi * (np.arange(cells) + 0.5) / cells
        grid = np.stack(np.meshgrid(first, second, [0.4], indexing="ij"), axis=-1).reshape(-1, 3)
        bits = np.unpackbits(np.frombuffer(base64.b64decode(truth["free"]), np.uint8))
        assert np.array_equal(bits[: len(grid)].astype(bool), checks.valid_batch(grid))
        page.goto("about:blank")
