"""The workbench as a person uses it, compared with the planar world's own checks."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from cspace.files import encode_png
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from inference_api.auth import digest_of
from tests.browser.workbench import (
    ENDS,
    SCENE,
    answer_of,
    bench_server,
    checker,
    discs_in_address,
    drag,
    hash_of,
    open_bench,
    plan,
    settle,
    shown_samples,
    to_angles,
    wait_for_disc,
)
from tests.bundles import write_tiny_bundle
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e]
DROP = """([name, bytes]) => {
    const data = new DataTransfer();
    data.items.add(new File([Uint8Array.from(bytes)], name));
    const options = {dataTransfer: data, bubbles: true, cancelable: true};
    return document.querySelector("#scene").dispatchEvent(new DragEvent("drop", options));
}"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with bench_server(tmp_path_factory.mktemp("bench")) as found:
        yield found


def test_samples_avoid_a_disc_that_is_dragged(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE))
    before = shown_samples(page)
    page.evaluate("() => performance.clearMeasures()")
    drag(page, (0.5, -3.2), (1.5, -1.8), steps=20)
    wait_for_disc(page, 2, 1.5, -1.8)
    moved = checker(discs_in_address(page))
    after = shown_samples(page)
    assert len(before) == len(after) == 300
    assert np.mean(~moved.valid_batch(before)) > 0.05
    assert np.mean(~moved.valid_batch(after)) < 0.02
    # Samples follow while the disc is dragged.
    assert page.evaluate("() => performance.getEntriesByName('interaction-to-samples').length") >= 3


def test_a_path_is_free_by_an_independent_check_and_is_played(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE, **ENDS))
    request, answer = plan(page)
    assert (request["seed"], request["time_limit_s"], request["ways"]) == ("7", 5, 4)
    assert answer["status"] == "solved", answer["reason"]
    path = np.array(answer["path"])
    assert checker(SCENE).edge_batch(path[:-1], path[1:], 0.005).all()
    expect(page.locator("#plan-status")).to_contain_text("Checked against the discs: collision-free.")
    lowest = f"Lowest confidence {answer['least_sure']['confidence']:.3f} after"
    expect(page.locator("#plan-confidence")).to_contain_text(lowest)
    assert (page.locator("#torus .path").get_attribute("d") or "").count("M") >= len(path) - 1
    assert (page.locator("#scene .arm.ghost").get_attribute("d") or "").count("M") == 14
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    slider = page.get_by_role("slider", name="Along the path")
    slider.press("End")
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    assert slider.input_value() == "1000"
    # A path belongs to its scene.
    page.get_by_role("button", name="Add a disc").click()
    expect(page.locator("#torus .path")).to_have_attribute("d", "")
    expect(page.locator("#plan-confidence")).to_be_empty()


def test_fields_of_the_plan_are_sent_and_stand_in_the_address(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE, **ENDS))
    fields = page.get_by_label("Plan", exact=True)
    fields.get_by_label("paths", exact=True).fill("2")
    fields.get_by_label("seed").fill("18446744073709551615")
    fields.get_by_label("time limit, s").fill("1.5")
    fields.get_by_label("minimum confidence").select_option("0.5")
    page.wait_for_url(re.compile("plan=18446744073709551615,1.5,2,0.5"))
    open_bench(page, address, f"#{page.url.partition('/#')[2]}")
    request, answer = plan(page)
    assert (request["seed"], request["time_limit_s"], request["ways"]) == ("18446744073709551615", 1.5, 2)
    assert request["min_confidence"] == 0.5
    assert answer["seed"] == "18446744073709551615"


def test_a_refused_path_shows_its_reason_and_where_its_confidence_is_lowest(page: Page, address: str) -> None:
    scene = hash_of([(2.5, 0.0, 1.0)], start="2.4,0.3", goal="0.45,0", plan="7,5,4,0.99")
    open_bench(page, address, scene)
    _, answer = plan(page)
    assert answer["status"] == "refused"
    expect(page.locator("#plan-status")).to_have_text(f"Refused: {answer['reason']}.")
    expect(page.locator("#plan-status")).to_have_class("note bad")
    expect(page.locator("#torus .least")).to_be_visible()
    expect(page.locator("#torus .path")).to_have_attribute("d", "")
    expect(page.get_by_role("button", name="Play")).to_be_disabled()


def test_edges_of_low_confidence_are_marked(page: Page, tmp_path: Path) -> None:
    # Its head prefers joints near 0 rad, and its plans are not calibrated: nothing is refused.
    bundle = write_tiny_bundle(tmp_path / "bundle", validity=True)
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundle), "CSPACE_API_WORKBENCH": "1"}
    with api_server(tmp_path, settings) as own:
        open_bench(page, own, hash_of([], start="0,0.3", goal="2.6,1.5"))
        _, answer = plan(page)
        uncertain = [edge < 0.9 for edge in answer["edges"]]
        assert any(uncertain)
        expect(page.locator("#plan-confidence")).to_contain_text("Per edge")
        drawn = [page.locator(f"#torus .{kind}").get_attribute("d") for kind in ("path", "uncertain")]
        assert all(drawn)
        assert (drawn[0] == drawn[1]) is all(uncertain)
        mark = page.locator("#torus .least")
        place = [[float(mark.get_attribute(name) or "nan") for name in ("cx", "cy")]]
        assert np.allclose(to_angles(np.array(place))[0], answer["least_sure"]["configuration"], atol=1e-3)
        page.goto("about:blank")


def test_a_dropped_picture_replaces_the_discs_and_a_broken_one_is_refused(page: Page, address: str) -> None:
    open_bench(page, address)
    problem = page.get_by_role("alert")
    page.evaluate(DROP, ["broken.png", list(b"\x89PNG nothing of the kind")])
    expect(problem).to_contain_text("PNG")
    noise = encode_png(np.random.default_rng(0).integers(0, 256, (48, 48)).astype(np.uint8))
    with page.expect_request("**/sample") as request:
        page.evaluate(DROP, ["noise.png", list(noise)])
    expect(problem).to_be_hidden()
    picture = page.get_by_alt_text("Input picture of the model")
    assert picture.get_attribute("src") == f"data:image/png;base64,{request.value.post_data_json['image']}"
    expect(page.locator("#disc-status")).to_have_text("dropped picture, no discs")
    # The model has never seen such a picture.
    expect(page.locator("#numbers [data-name=novelty]")).to_have_class("warning")
    expect(page.locator("#numbers")).not_to_contain_text("precision")
    with page.expect_response(answer_of("sample")):
        page.get_by_role("button", name="Back to discs").click()
    expect(page.locator("#numbers")).to_contain_text("precision")


def test_changes_made_without_the_api_are_shown_when_it_is_back(page: Page, address: str) -> None:
    open_bench(page, address, hash_of(SCENE))
    cut = "**/{sample,health/live,workbench/*,models}"
    page.route(cut, lambda route: route.abort("connectionrefused"))
    drag(page, (0.5, -3.2), (1.5, -1.8))
    expect(page.locator("#connection")).to_have_text("The API is not reachable; retrying")
    with page.expect_response(answer_of("truth")):
        page.unroute(cut)
    expect(page.locator("#connection")).to_contain_text("300 samples")
    settle(page)
    assert np.mean(~checker(discs_in_address(page)).valid_batch(shown_samples(page))) < 0.02


def test_an_address_opens_the_same_scene_again(page: Page, address: str) -> None:
    first = open_bench(page, address, hash_of(SCENE, seed="11", n="50", start="1,0.5"))
    page.get_by_role("button", name="Add a disc").click()
    page.wait_for_url(re.compile(r"discs=([^;&]*;){3}"))
    settle(page)
    shown = shown_samples(page)
    again = open_bench(page, address, f"#{page.url.partition('/#')[2]}")
    assert (again["seed"], len(again["samples"])) == ("11", 50) == (first["seed"], len(first["samples"]))
    assert np.allclose(shown_samples(page), shown)
    expect(page.get_by_role("button", name="Disc 4")).to_be_visible()


@pytest.mark.parametrize("form", ["curl", "Python"])
@pytest.mark.parametrize("endpoint", ["sample", "plan"])
def test_what_is_copied_sends_the_same_request(
    page: Page, address: str, form: str, endpoint: str, tmp_path: Path
) -> None:
    shown = open_bench(page, address, hash_of(SCENE, n="5"))
    page.locator("#take-what").select_option(endpoint)
    page.get_by_role("button", name=f"Copy as {form}").click()
    expect(page.locator("#take-status")).not_to_be_empty()
    text = page.locator("#take-text").input_value()
    command = ["bash", "-c", text] if form == "curl" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60)
    if endpoint == "plan":
        assert "solved" in done.stdout
    else:
        rows = done.stdout.partition('"samples":')[2].partition('"confidence"')[0] or done.stdout
        numbers = [float(one) for one in re.findall(r"-?\d+\.\d+", rows)]
        assert numbers[:10] == [angle for row in shown["samples"] for angle in row]


def test_a_server_without_scenes_takes_dropped_pictures(page: Page, address: str, tmp_path: Path) -> None:
    open_bench(page, address, hash_of(SCENE, **ENDS))
    picture = quote((page.get_by_alt_text("Input picture").get_attribute("src") or "").partition(",")[2])
    with api_server(tmp_path, {}) as plain:
        page.goto(f"{plain}/{hash_of(SCENE)}")
        expect(page.get_by_text("This server draws no scenes.")).to_be_visible()
        open_bench(page, plain, f"{hash_of(SCENE, **ENDS, ground='prediction')}&picture={picture}")
        assert len(shown_samples(page)) == 300
        expect(page.locator("#torus .ground-3")).to_have_attribute("d", re.compile("^M"))
        _, answer = plan(page)
        assert answer["status"] == "solved"
        expect(page.locator("#plan-status")).not_to_contain_text("Checked")
        page.goto("about:blank")


def test_a_key_is_asked_for_and_kept_in_memory_only(page: Page, tmp_path: Path) -> None:
    key = "csk_of-this-test"
    keys = tmp_path / "keys"
    keys.write_text(f"bench:{digest_of(key)}\n")
    keys.chmod(0o600)
    settings = {"CSPACE_API_KEYS_FILE": str(keys), "CSPACE_API_WORKBENCH": "1"}
    with api_server(tmp_path, settings) as locked:
        page.goto(f"{locked}/")
        expect(page.get_by_role("alert")).to_contain_text("A key is needed")
        page.get_by_label("API key").fill("wrong")
        page.get_by_role("button", name="Use the key").click()
        expect(page.get_by_role("alert")).to_contain_text("an unknown key")
        page.get_by_label("API key").fill(key)
        page.get_by_role("button", name="Use the key").click()
        expect(page.locator("#connection")).to_contain_text("300 samples")
        kept = "() => JSON.stringify([{...localStorage}, {...sessionStorage}, document.cookie])"
        assert key not in page.evaluate(kept)
        assert key not in page.url
        page.goto("about:blank")


def test_an_arm_of_three_joints_with_limits_has_a_map_of_two(page: Page, tmp_path: Path) -> None:
    arm = PlanarArm((1.6, 1.4, 1.0), joint_limits_rad=((-1.0, 2.0), None, (-0.5, 0.5)))
    bundle = write_tiny_bundle(tmp_path / "bundle", arm, validity=True)
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundle), "CSPACE_API_WORKBENCH": "1"}
    with api_server(tmp_path, settings) as own:
        page.goto("about:blank")
        with page.expect_response(answer_of("truth")) as response:
            answer = open_bench(page, own, hash_of(SCENE, start="0.5,1,0.4", goal="9,9,9", n="20"))
        assert len(answer["samples"][0]) == 3
        expect(page.locator("#scene .handle")).to_have_count(6)
        # Joints with limits stop there, circles wrap.
        page.wait_for_url(re.compile(r"goal=2,2.717,0.5"))
        checks = CollisionChecker(Scenario(arm, tuple(Disc(*disc) for disc in SCENE)))
        assert response.value.json()["sample_free"] == checks.valid_batch(answer["samples"]).tolist()
        # The map is a slice of the joint space at the start's third joint.
        assert response.value.request.post_data_json["at"] == [0.5, 1, 0.4]
        page.goto("about:blank")
