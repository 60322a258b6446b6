from pathlib import Path

import pytest

from cspace.errors import ConfigError
from cspace.files import IGNORE_FILE
from services.local.settings import FOLDERS, MARKER, Settings

ROOT = Path("/somewhere/checkout")


def read(**environment: str) -> Settings:
    return Settings.from_environment({"HOME": "/home/anna", **environment}, ROOT)


def test_without_settings_the_defaults_hold() -> None:
    settings = read()
    assert settings.home == Path("/home/anna/.local/state/cspace-sampler")
    assert (settings.api_url, settings.ray_url, settings.mlflow_url) == (
        "http://127.0.0.1:8000",
        "http://127.0.0.1:8265",
        "http://127.0.0.1:5000",
    )
    assert settings.ray_cpus >= 2


def test_the_state_folder_follows_xdg_and_its_own_setting_comes_first() -> None:
    assert read(XDG_STATE_HOME="/var/anna").home == Path("/var/anna/cspace-sampler")
    assert read(XDG_STATE_HOME="/var/anna", CSPACE_HOME="/data/cspace").home == Path("/data/cspace")


def test_an_empty_setting_counts_as_not_set() -> None:
    assert read(CSPACE_HOME="", CSPACE_API_PORT="", CSPACE_RAY_CPUS="") == read()


@pytest.mark.parametrize("value", ["0", "65536", "-1", "8000.0", "http", "٨٠٠٠", "8 000"])
def test_a_port_that_is_none_is_an_error_that_names_the_setting(value: str) -> None:
    with pytest.raises(ConfigError, match="CSPACE_RAY_PORT") as raised:
        read(CSPACE_RAY_PORT=value)
    assert "1 to 65535" in str(raised.value)


def test_two_services_on_one_port_are_an_error() -> None:
    with pytest.raises(ConfigError, match="CSPACE_API_PORT=9000, CSPACE_RAY_PORT=9000"):
        read(CSPACE_API_PORT="9000", CSPACE_RAY_PORT="9000")


@pytest.mark.parametrize(
    "home", ["/", "/home/anna", "/home", "/somewhere/checkout", "/somewhere", "relative/folder"]
)
def test_a_state_folder_that_holds_other_things_is_refused(home: str) -> None:
    with pytest.raises(ConfigError, match="CSPACE_HOME"):
        read(CSPACE_HOME=home)


def test_a_state_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="CSPACE_HOME"):
        read(CSPACE_HOME=str(tmp_path / "file"))


def test_the_state_folder_is_made_for_its_user_alone(settings: Settings) -> None:
    assert settings.home.stat().st_mode & 0o077 == 0
    assert {path.name for path in settings.home.iterdir()} == {*FOLDERS, MARKER, IGNORE_FILE}


def test_a_state_folder_that_cannot_be_made_is_a_setting_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    settings = Settings(home=tmp_path / "file" / "state", root=tmp_path)
    with pytest.raises(ConfigError, match="CSPACE_HOME"):
        settings.make_folders()
