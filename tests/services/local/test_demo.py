"""The demo starts the API alone and opens its page where there is a screen."""

import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from services.local import commands
from services.local.__main__ import main
from services.local.commands import demo
from services.local.processes import Service
from services.local.settings import Settings


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the services that would be started."""
    found: list[str] = []

    def up(settings: Settings, wanted: tuple[Service, ...], say: object) -> None:
        found.extend(service.name for service in wanted)

    monkeypatch.setattr(commands, "up", up)
    return found


@pytest.mark.parametrize(
    ("browser", "environment", "opens"),
    [
        (True, {"DISPLAY": ":0"}, True),
        (True, {"WAYLAND_DISPLAY": "wayland-0"}, True),
        (True, {"DISPLAY": ""}, False),
        (True, {}, False),
        (False, {"DISPLAY": ":0"}, False),
    ],
)
def test_the_page_is_opened_where_there_is_a_screen_and_one_is_wanted(
    own_settings: Settings, started: list[str], browser: bool, environment: dict[str, str], opens: bool
) -> None:
    said: list[str] = []
    opened: list[str] = []
    demo(own_settings, said.append, browser=browser, environment=environment, open_page=opened.append)
    page = f"http://127.0.0.1:{own_settings.viewer_port}/"
    assert started == ["api", "viewer"]
    assert page in said[-1]
    assert opened == ([page] if opens else [])


@pytest.fixture
def ended(own_settings: Settings) -> Iterator[None]:
    yield
    assert main(["down"]) == 0


@pytest.mark.e2e
def test_the_page_and_its_first_samples_are_there_within_40_s(
    own_settings: Settings, ended: None, capsys: pytest.CaptureFixture[str]
) -> None:
    began = time.monotonic()
    assert main(["demo", "--no-browser"]) == 0
    page = f"http://127.0.0.1:{own_settings.api_port}/"
    assert page in capsys.readouterr().out
    assert httpx.get(page).status_code == 200
    assert httpx.get(f"{page}workbench/about").json()["truth"] is True
    picture = (Path(__file__).parents[3] / "docs" / "images" / "scenario.png").read_bytes()
    answer = httpx.post(f"{page}sample", files={"image": picture}, timeout=20)
    assert answer.json()["model"]["name"] == "pretrained"
    assert "<html" in httpx.get(f"http://127.0.0.1:{own_settings.viewer_port}/").text
    assert time.monotonic() - began < 40.0
