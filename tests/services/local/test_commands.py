"""The commands as users call them: exit codes and what is printed."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from services.local.__main__ import main
from services.local.stack import Settings, make_state

pytestmark = pytest.mark.usefixtures("settings")
ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("arguments", [[], ["fly"], ["up", "--fast"]])
def test_wrong_usage_ends_with_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2


def test_a_wrong_setting_ends_with_2_and_a_strangers_port_with_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        monkeypatch.setenv("CSPACE_RAY_PORT", str(stranger.getsockname()[1]))
        assert main(["up"]) == 3
    monkeypatch.setenv("CSPACE_RAY_PORT", "eight thousand")
    assert main(["status"]) == 2
    assert capsys.readouterr().err.count("CSPACE_RAY_PORT") == 2


def test_without_services_status_ends_with_4_and_down_with_0(
    settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status"]) == 4
    assert main(["down"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("not running") == 3
    assert "nothing was running" in printed
    assert not settings.home.exists()


def test_env_sets_a_shell_up(settings: Settings, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["env"]) == 0
    script = f"{capsys.readouterr().out}\nenv"
    shell = subprocess.run(
        ["/bin/sh", "-c", script], env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, check=True
    )
    values = dict(line.split("=", 1) for line in shell.stdout.splitlines() if "=" in line)
    assert values["RAY_AUTH_MODE"] == "token"
    assert values["RAY_ADDRESS"] == settings.url("ray")
    assert values["MLFLOW_TRACKING_URI"] == settings.url("mlflow")
    assert values["CSPACE_API_URL"] == settings.url("api")
    assert values["CSPACE_OUTCOMES"] == str(settings.home / "data" / "outcomes")
    assert values["PATH"] == f"{Path(sys.executable).parent}:/usr/bin:/bin"


@pytest.mark.parametrize(("answer", "code", "kept"), [("y", 0, False), ("n", 1, True), ("", 1, True)])
def test_clean_state_shows_what_goes_and_does_what_the_answer_says(
    settings: Settings,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    answer: str,
    code: int,
    kept: bool,
) -> None:
    make_state(settings)
    (settings.home / "data" / "large.npy").write_bytes(bytes(9_000_000))
    assert main(["clean-state"]) == 2  # nobody to ask
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: answer)
    assert main(["clean-state"]) == code
    assert settings.home.exists() == kept
    assert f"{settings.home / 'data'}" in (shown := capsys.readouterr().out)
    assert "9.0 MB" in shown


@pytest.mark.usefixtures("programs")
@pytest.mark.parametrize(
    ("options", "screen", "opens"), [([], ":0", True), ([], "", False), (["--no-browser"], ":0", False)]
)
def test_demo_prints_the_address_that_the_viewer_reports_and_opens_it_on_a_screen(
    settings: Settings,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    screen: str,
    opens: bool,
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    for name in ("WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", screen)
    assert main(["demo", *options]) == 0
    page = f"http://127.0.0.1:{settings.viewer_port}/?token=secret"
    assert page in capsys.readouterr().out
    assert opened == ([page] if opens else [])
    assert main(["clean-state", "--yes"]) == 1  # services run


@pytest.mark.parametrize("name", ["a b", "R&D", "50$", "a:b", "plain", "with-._~+@%,=", "Größe"])
def test_make_refuses_a_path_below_which_ray_cannot_run_before_it_installs(tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    for file in ("pyproject.toml", "clients/python/pyproject.toml", "constraints.txt"):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()
    # Where the path is no hindrance, it goes on to look for Python, which is not there.
    command = ["make", "-s", "-f", str(ROOT / "Makefile"), "PYTHON=/not/there", "venv"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    refused = any(character in name for character in " &$:")
    assert done.stderr.startswith("Ray cannot run below the folder" if refused else "Python")
    assert not (folder / ".venv").exists()
