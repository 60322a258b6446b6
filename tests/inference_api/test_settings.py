from pathlib import Path

import pytest

from cspace.errors import ConfigError
from inference_api.settings import PRETRAINED_FOLDER, ApiSettings, ConnectionLimits, further_folders
from services.registry.ports import PRETRAINED, SHIPPED


def test_an_empty_environment_serves_the_shipped_model_from_defaults() -> None:
    settings = ApiSettings.from_environment({"XDG_CACHE_HOME": "/var/cache/user"})
    folders = Path("/var/cache/user/cspace-sampler/models")
    assert settings == ApiSettings(None, folders, further_folders=further_folders())
    assert PRETRAINED_FOLDER.parent.name == "inference_api"
    assert set(further_folders()) == set(SHIPPED) - {PRETRAINED}


def test_who_serves_a_folder_of_their_own_gets_no_other_shipped_model() -> None:
    assert ApiSettings.from_environment({"CSPACE_PRETRAINED_MODEL": "/srv/shipped"}).further_folders == {}


def test_every_setting_is_read() -> None:
    environment = {
        "MLFLOW_TRACKING_URI": "http://127.0.0.1:5000",
        "CSPACE_MODEL_CACHE": "/srv/models",
        "CSPACE_MODEL_NAME": "arm",
        "CSPACE_MODEL_POLL_S": "0.5",
        "CSPACE_PRETRAINED_MODEL": "/srv/shipped",
        "CSPACE_LOADED_MODELS": "7",
        "CSPACE_CACHED_PICTURES": "9",
        "CSPACE_API_THREADS": "3",
    }
    assert ApiSettings.from_environment(environment) == ApiSettings(
        "http://127.0.0.1:5000", Path("/srv/models"), "arm", 0.5, Path("/srv/shipped"), 7, 9, 3
    )


def test_the_settings_of_the_edge_are_read() -> None:
    environment = {
        "CSPACE_API_MAX_CONNECTIONS": "7",
        "CSPACE_API_HEADER_TIMEOUT_S": "1.5",
        "CSPACE_API_WRITE_TIMEOUT_S": "2.5",
        "CSPACE_API_GRACE_S": "3",
        "CSPACE_API_HELD_BODIES_MIB": "9",
        "CSPACE_API_HOSTS": "api,::1",
        "CSPACE_API_ORIGINS": "https://site.example",
        "CSPACE_API_TRUSTED_PROXIES": "10.0.0.0/8",
    }
    settings = ApiSettings.from_environment(environment)
    assert settings.connections == ConnectionLimits(7, 1.5, 2.5)
    assert settings.grace_s == 3
    protection = settings.protection
    assert (protection.held_body_bytes, protection.hosts) == (9 * 2**20, ("api", "[::1]"))
    assert protection.origins == ("https://site.example",)
    assert protection.trusted_proxies == ("10.0.0.0/8",)


@pytest.mark.parametrize("name", ["../m", "m/1", "m@champion", ".m", "a" * 101, "pretrained", "m\n"])
def test_a_default_that_no_request_could_name_is_a_wrong_setting(name: str) -> None:
    with pytest.raises(ConfigError, match="CSPACE_MODEL_NAME"):
        ApiSettings.from_environment({"CSPACE_MODEL_NAME": name})


def test_a_default_that_requests_can_name_is_taken() -> None:
    assert ApiSettings.from_environment({"CSPACE_MODEL_NAME": "a.b_c-d"}).model_name == "a.b_c-d"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("CSPACE_MODEL_POLL_S", "0"),
        ("CSPACE_MODEL_POLL_S", "nan"),
        ("CSPACE_MODEL_POLL_S", "inf"),
        ("CSPACE_MODEL_POLL_S", "soon"),
        ("CSPACE_LOADED_MODELS", "0"),
        ("CSPACE_API_THREADS", "0"),
        ("CSPACE_STORED_MODELS", "0"),
        ("CSPACE_API_MAX_CONNECTIONS", "0"),
        ("CSPACE_API_HEADER_TIMEOUT_S", "0"),
        ("CSPACE_API_WRITE_TIMEOUT_S", "soon"),
        ("CSPACE_API_GRACE_S", "0"),
        ("CSPACE_API_HELD_BODIES_MIB", "7"),
        ("CSPACE_API_HOSTS", "api:80"),
        ("CSPACE_API_ORIGINS", "*"),
        ("CSPACE_API_TRUSTED_PROXIES", "*"),
    ],
)
def test_a_wrong_setting_is_an_error_that_names_it(name: str, value: str) -> None:
    with pytest.raises(ConfigError, match=name):
        ApiSettings.from_environment({name: value})
