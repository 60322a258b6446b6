"""The workbench in a browser: opens it and reads its drawings."""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page, Response, expect

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from tests.inference_api.server import api_server

SIDE = 480.0
# Half of the plane that the picture shows.
HALF_M = 5.0
Discs = list[tuple[float, float, float]]
SCENE: Discs = [(2.6, 1.9, 1.0), (-1.9, 2.5, 1.0), (0.5, -3.2, 1.0)]
ENDS = {"start": "0,0.3", "goal": "-2.6,-0.6"}


@contextmanager
def bench_server(folder: Path) -> Iterator[str]:
    """A server on the shipped model with scenes; its kernels are compiled."""
    with api_server(folder, {"CSPACE_API_WORKBENCH": "1"}) as address:
        body = {"discs": [], "path": [[0, 0], [1, 1]]}
        for route in ("picture", "truth"):
            httpx.post(f"{address}/workbench/{route}", json=body, timeout=60).raise_for_status()
        yield address


def hash_of(discs: Discs, **fields: str) -> str:
    """The part of an address behind its # that shows these discs."""
    values = {"discs": ";".join(",".join(f"{value:g}" for value in disc) for disc in discs), **fields}
    return "#" + "&".join(f"{name}={value}" for name, value in values.items())


def checker(discs: Discs) -> CollisionChecker:
    """The checks of the two-link arm among discs."""
    return CollisionChecker(Scenario(TWO_LINK, tuple(Disc(*disc) for disc in discs)))


def answer_of(endpoint: str) -> Callable[[Response], bool]:
    """Whether a response comes from an endpoint."""
    return lambda response: response.url.endswith(f"/{endpoint}")


def open_bench(page: Page, address: str, fragment: str = "") -> dict[str, Any]:
    """Open the page again and return the first answer of /sample once it is drawn."""
    page.goto("about:blank")
    with page.expect_response(answer_of("sample")) as samples:
        page.goto(f"{address}/{fragment}")
    found: dict[str, Any] = samples.value.json()
    settle(page)
    return found


def settle(page: Page) -> None:
    """Wait until the page waits for nothing."""
    expect(page.locator("[aria-busy=true]")).to_have_count(0)


def plan(page: Page) -> tuple[dict[str, Any], dict[str, Any]]:
    """Plan a path; returns the request and the answer."""
    with page.expect_response(answer_of("plan"), timeout=90_000) as answer:
        page.get_by_role("button", name="Plan a path").click()
    found: dict[str, Any] = answer.value.json()
    return json.loads(answer.value.request.post_data or ""), found


def wait_for_disc(page: Page, at: int, x_m: float, y_m: float) -> None:
    """Wait until a disc is where it was dragged, in the page's address too, and its samples are there."""
    page.wait_for_url(lambda _: np.hypot(*np.subtract(discs_in_address(page)[at][:2], (x_m, y_m))) < 0.05)
    settle(page)


def shown_samples(page: Page) -> NDArray[np.float64]:
    """(n, 2) rad: what is drawn in the joint space, crossed ones included."""
    found = []
    for level in range(4):
        dots = page.locator(f"#torus .dots-{level}").get_attribute("d") or ""
        found += re.findall(r"M([-\d.]+) ([-\d.]+)h0", dots)
    crosses = page.locator("#torus .crosses").get_attribute("d") or ""
    crossed = re.findall(r"M([-\d.]+) ([-\d.]+)l8", crosses)
    places = [(float(x), float(y)) for x, y in found] + [(float(x) + 4, float(y) + 4) for x, y in crossed]
    return to_angles(np.array(places, dtype=np.float64).reshape(-1, 2))


def to_angles(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (n, 2) of the drawing as angles, rad."""
    return np.stack([places[:, 0] / SIDE - 0.5, 0.5 - places[:, 1] / SIDE], axis=1) * 2.0 * np.pi


def discs_in_address(page: Page) -> Discs:
    """The discs of the page's address."""
    rows = re.search(r"discs=([^&]*)", page.url)
    assert rows is not None, page.url
    return [tuple(map(float, row.split(","))) for row in rows[1].split(";") if row]  # type: ignore[misc]


def drag(page: Page, start: tuple[float, float], end: tuple[float, float], steps: int = 12) -> None:
    """Drag what lies at a place of the plane, m, to another one."""
    page.mouse.move(*_place_of(page, *start))
    page.mouse.down()
    page.mouse.move(*_place_of(page, *end), steps=steps)
    page.mouse.up()


def _place_of(page: Page, x_m: float, y_m: float) -> tuple[float, float]:
    """Where a place of the plane is in the window, px."""
    box = page.locator("#scene").bounding_box()
    assert box is not None
    return (
        box["x"] + (x_m + HALF_M) / (2 * HALF_M) * box["width"],
        box["y"] + (HALF_M - y_m) / (2 * HALF_M) * box["height"],
    )
