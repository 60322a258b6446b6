"""The 3D viewer against the real API, in a real browser."""

import re
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from cspace.bundle import write_bundle
from cspace.bundle.files import read_files
from cspace.errors import InputError
from services.planner.viewer import world_of
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.browser.viewer import open_viewer, plan_in_viewer, viewer_at
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.server import api_server
from tests.space_bundle import SPEC, space_graphs

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.timeout(300), *MLFLOW_WARNINGS]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with api_server(tmp_path_factory.mktemp("api"), {}) as api, viewer_at(api) as found:
        yield found


def test_a_scene_is_sampled_planned_and_changed(page: Page, address: str) -> None:
    open_viewer(page, address)
    # The first scene shows what the arm can do, the other example what it refuses to do.
    assert re.search(r"Confidence \d+%. In the true scene the path is collision-free.", plan_in_viewer(page))
    page.get_by_text("show what the model expects").click()
    page.get_by_role("button", name="hard bin").click()
    expect(page.get_by_role("combobox", name="family")).to_have_value("bin")
    page.get_by_role("button", name="Plan a path").click()
    expect(page.get_by_text("refused")).to_be_visible()
    figures = page.get_by_text("confidence of the samples")
    before = figures.text_content() or ""
    page.get_by_role("textbox", name="seed").fill("3")
    expect(figures).not_to_have_text(before)
    expect(page.get_by_text("Error")).to_have_count(0)
    # Another scene has another path.
    expect(page.get_by_text("In the true scene the path is")).to_have_count(0)


def test_the_page_opens_with_its_token_only(page: Page, address: str) -> None:
    page.goto(address.rsplit("/", 2)[0])
    expect(page.get_by_text("it holds a token")).to_be_visible()
    foreign = """(url) => new Promise((done) => {
        const socket = new WebSocket(url, "viser-v1.1.1");
        socket.onopen = () => done("open");
        socket.onerror = () => done("refused");
    })"""
    url = address.replace("http://", "ws://").rstrip("/")
    assert page.evaluate(foreign, url) == "open"
    page.goto("about:blank")
    # Knowing the token does not help a page of another origin.
    assert page.evaluate(foreign, url) == "refused"


def test_figures_do_not_outlive_their_scene(page: Page, tmp_path: Path) -> None:
    with ExitStack() as served:
        address = served.enter_context(api_server(tmp_path, {}))
        with viewer_at(address) as shown:
            open_viewer(page, shown)
            served.close()
            page.get_by_role("textbox", name="seed").fill("3")
            expect(page.get_by_text("Error")).to_be_visible()
            expect(page.get_by_text("confidence of the samples")).to_have_count(0)


@pytest.mark.slow
def test_the_model_of_an_own_arm_is_shown(page: Page, server: str, tmp_path: Path) -> None:
    own = replace(SPEC.world, body=replace(SPEC.world.body, name="bench-arm"))
    folder = write_bundle(tmp_path / "bundle", replace(SPEC, world=own), space_graphs())
    with Tracking(server).start("own-arm", "training") as run:
        digest, registry = read_files(folder).digest, ModelRegistry(server)
        registry.register("bench-arm-sampler", folder, run.run_id, digest, {}, alias="champion")
    with api_server(tmp_path, {"MLFLOW_TRACKING_URI": server}) as api:
        # A model's world is listed once it is loaded.
        httpx.post(f"{api}/sample", json={"model": "bench-arm-sampler", "image": "AA=="}, timeout=60)
        assert world_of(api, "bench-arm-sampler") == world_of(api, "bench-arm-sampler@champion") == own
        with pytest.raises(InputError, match="cannot show the model"):
            world_of(api, "bench-arm-sampler/2")
        with viewer_at(api, "--model=bench-arm-sampler/1") as address:
            open_viewer(page, address)
            expect(page.get_by_text("Model: bench-arm-sampler/1")).to_be_visible()
