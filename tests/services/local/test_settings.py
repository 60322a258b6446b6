"""Settings from the environment, and the state folder that they name."""

from pathlib import Path

import pytest

from cspace.errors import ConfigError
from services.commands import settings_of
from services.local.stack import (
    FOLDERS,
    IGNORE,
    MARKER,
    ROOT,
    Settings,
    drop_state,
    make_state,
)


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/anna")
    for name in ("XDG_STATE_HOME", *(f"CSPACE_{field.upper()}" for field in Settings.model_fields)):
        # Empty counts as not set.
        monkeypatch.setenv(name, "")


def test_without_settings_the_defaults_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    found = settings_of(Settings)
    assert found.home == Path("/home/anna/.local/state/cspace-sampler")
    assert (found.url("api"), found.url("ray")) == ("http://127.0.0.1:8000", "http://127.0.0.1:8265")
    assert found.ray_cpus >= 2
    monkeypatch.setenv("XDG_STATE_HOME", "/var/anna")
    assert settings_of(Settings).home == Path("/var/anna/cspace-sampler")
    monkeypatch.setenv("CSPACE_HOME", "/data/cspace")
    assert settings_of(Settings).home == Path("/data/cspace")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("CSPACE_RAY_PORT", value) for value in ("0", "65536", "http")),
        *(
            ("CSPACE_HOME", value)
            for value in ("/", "/home/anna", str(ROOT), str(ROOT.parent), "relative", __file__)
        ),
        ("CSPACE_HOME", "/data/#1"),
        ("CSPACE_RAY_CPUS", "0"),
    ],
)
def test_a_wrong_setting_is_named(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=f"(?s){name}.*{value}"):
        settings_of(Settings)


def test_the_state_folder_is_for_its_user_alone_and_goes_with_all_that_is_the_projects(
    tmp_path: Path,
) -> None:
    settings = Settings(home=tmp_path / "state")
    make_state(settings)
    assert settings.home.stat().st_mode & 0o077 == 0
    assert {path.name for path in settings.home.iterdir()} == {*FOLDERS, MARKER, IGNORE}
    (settings.home / "mlflow" / "mlflow.db").touch()
    drop_state(settings)
    assert not settings.home.exists()
    make_state(settings)
    (settings.home / "thesis.tex").touch()
    drop_state(settings)
    assert [path.name for path in settings.home.iterdir()] == ["thesis.tex"]


def test_a_folder_that_somebody_else_made_is_left_alone(tmp_path: Path) -> None:
    settings = Settings(home=tmp_path / "own")
    (settings.home / "data").mkdir(parents=True)
    for refused in (make_state, drop_state):
        with pytest.raises(ConfigError, match="not a state folder"):
            refused(settings)
    assert [path.name for path in settings.home.iterdir()] == ["data"]


def test_paths_of_sockets_are_short_and_differ_between_state_folders(tmp_path: Path) -> None:
    # A socket's path ends at 107 bytes, and Ray appends 64 to its folder.
    long = Settings(home=tmp_path / ("deep" * 30))
    assert len(str(long.temp_folder)) <= 38
    assert long.temp_folder != Settings(home=tmp_path).temp_folder
