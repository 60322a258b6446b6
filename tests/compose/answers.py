"""A request for samples that is always the same."""

from collections.abc import Mapping
from typing import Any

import httpx

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.simulator import render
from services.local.quickstart import wait_served
from tests.compose.stack import Stack
from tests.scenarios import random_scenarios


def ask_for_samples(stack: Stack, **fields: str) -> httpx.Response:
    """Ask for 300 samples of one picture, by one seed."""
    return httpx.post(f"{stack.url('API')}/sample", timeout=60, **request(**fields))


def ask_for_plan(stack: Stack, **fields: str) -> httpx.Response:
    """Ask for a way through the same picture, by one seed."""
    body = request(**fields)
    ends = {"start": "[1.5, 0.5]", "goal": "[-1.5, 0.5]", "seed": "1", "time_limit_s": "10"}
    data = {name: value for name, value in body["data"].items() if name not in ("n", "seed")} | ends
    return httpx.post(f"{stack.url('API')}/plan", timeout=60, files=body["files"], data=data)


def serves_champion(stack: Stack, decided: Mapping[str, Any]) -> None:
    """Wait until the API answers with the version that the gate decided about. Raises when it does not."""
    wait_served(stack.url("API"), f"{decided['model']}/{decided['version']}", default=True)


def request(**fields: str) -> dict[str, Any]:
    """The picture and the fields, as httpx takes them."""
    scenario = random_scenarios(Split.TEST, seed=3, count=1, robot=TWO_LINK)[0]
    picture = ("scenario.png", encode_png(render(scenario)), "image/png")
    return {"files": {"image": picture}, "data": {"n": "300", "seed": "7", **fields}}
