import socket

import pytest

from cspace.errors import ConfigError, CspaceError, JobError, PortTakenError
from services.local import settings
from services.local.__main__ import exit_code, main
from services.local.settings import Settings

pytestmark = pytest.mark.usefixtures("own_settings")
COMMANDS = ("up", "down", "status", "demo", "quickstart", "arm", "clean-state", "env")


@pytest.mark.parametrize(
    ("error", "code"),
    [(CspaceError("x"), 1), (JobError("x"), 1), (ConfigError("x"), 2), (PortTakenError("x"), 3)],
)
def test_every_error_has_its_documented_exit_code(error: CspaceError, code: int) -> None:
    assert exit_code(error) == code


@pytest.mark.parametrize("command", [[], *([name] for name in COMMANDS)])
def test_every_command_has_help_with_the_exit_codes(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as raised:
        main([*command, "--help"])
    assert raised.value.code == 0
    assert "Exit codes: 0 done" in capsys.readouterr().out


def test_the_help_names_the_settings_of_the_services(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    printed = capsys.readouterr().out
    ports = [name for name in vars(settings) if name.endswith("_PORT")]
    assert len(ports) == 4
    assert all(getattr(settings, name) in printed for name in ("HOME", "RAY_CPUS", *ports))


@pytest.mark.parametrize("arguments", [[], ["fly"], ["up", "--fast"]])
def test_wrong_usage_ends_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2
    assert "usage:" in capsys.readouterr().err


def test_a_wrong_setting_ends_with_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CSPACE_API_PORT", "eight thousand")
    assert main(["status"]) == 2
    assert "CSPACE_API_PORT" in capsys.readouterr().err


def test_up_on_a_port_of_a_stranger_ends_with_3_and_names_the_setting(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        monkeypatch.setenv("CSPACE_RAY_PORT", str(stranger.getsockname()[1]))
        assert main(["up"]) == 3
    assert "CSPACE_RAY_PORT" in capsys.readouterr().err


def test_status_of_nothing_ends_with_4_and_makes_no_folder(
    own_settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status"]) == 4
    assert capsys.readouterr().out.count("not running") == 3
    assert not own_settings.home.exists()


def test_down_with_nothing_up_ends_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["down"]) == 0
    assert "nothing was running" in capsys.readouterr().out


def test_env_prints_exports_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["env"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith("export ") for line in lines)
    assert "export RAY_AUTH_MODE=token" in lines


def test_clean_state_asks_somebody_or_wants_yes(
    own_settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    own_settings.make_folders()
    assert main(["clean-state"]) == 2
    assert own_settings.home.exists()
    assert "--yes" in capsys.readouterr().err
    assert main(["clean-state", "--yes"]) == 0
    assert not own_settings.home.exists()
    assert main(["clean-state"]) == 0
    assert "there is no" in capsys.readouterr().out


@pytest.mark.parametrize(("answer", "code", "kept"), [("y", 0, False), ("n", 1, True), ("", 1, True)])
def test_clean_state_shows_what_goes_and_does_what_the_answer_says(
    own_settings: Settings,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    answer: str,
    code: int,
    kept: bool,
) -> None:
    own_settings.make_folders()
    (own_settings.data_folder / "deep").mkdir()
    for name, size in (("large.npy", 9_000_000), ("deep/small.npy", 3_000_000)):
        (own_settings.data_folder / name).write_bytes(bytes(size))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: answer)
    assert main(["clean-state"]) == code
    assert own_settings.home.exists() == kept
    shown = capsys.readouterr().out
    assert str(own_settings.data_folder) in shown
    assert "12 MB" in shown


def test_a_folder_of_the_users_is_neither_used_nor_cleaned(
    own_settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    thesis = own_settings.data_folder / "thesis.tex"
    thesis.parent.mkdir(parents=True)
    thesis.write_text("years of work")
    for command in (["up"], ["clean-state", "--yes"]):
        assert main(command) == 2
        assert "is not a state folder of this project" in capsys.readouterr().err
    assert [path.name for path in own_settings.home.iterdir()] == ["data"]
    assert thesis.read_text() == "years of work"
