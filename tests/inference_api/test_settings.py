from pathlib import Path

import pytest

from cspace.errors import ConfigError
from inference_api.settings import (
    ApiSettings,
    ConnectionLimits,
    Protection,
    further_folders,
)
from services.registry.entities import PRETRAINED, SHIPPED


def test_an_empty_environment_serves_the_shipped_models_from_defaults() -> None:
    settings = ApiSettings.from_environment({"XDG_CACHE_HOME": "/var/cache/user"})
    folders = Path("/var/cache/user/cspace-sampler/models")
    assert settings == ApiSettings(cache_folder=folders, further_folders=further_folders())
    assert set(further_folders()) == set(SHIPPED) - {PRETRAINED}


def test_every_setting_is_read() -> None:
    environment = {
        "MLFLOW_TRACKING_URI": "http://127.0.0.1:5000",
        "CSPACE_MODEL_CACHE": "/srv/models",
        "CSPACE_MODEL_NAME": "a.b_c-d",
        "CSPACE_MODEL_POLL_S": "0.5",
        # Whoever serves a folder of their own gets no other shipped model.
        "CSPACE_PRETRAINED_MODEL": "/srv/shipped",
        "CSPACE_LOADED_MODELS": "7",
        "CSPACE_CACHED_PICTURES": "9",
        "CSPACE_API_THREADS": "3",
        "CSPACE_STORED_MODELS": "8",
        "CSPACE_API_KEYS_FILE": "/srv/keys",
        "CSPACE_API_MAX_IN_FLIGHT": "5",
        "CSPACE_API_BODY_TIMEOUT_S": "4.5",
        "CSPACE_API_RATE": "6.5",
        "CSPACE_API_BURST": "11",
        "CSPACE_API_HELD_BODIES_MIB": "9",
        "CSPACE_API_HOSTS": "api,::1",
        "CSPACE_API_ORIGINS": "https://site.example",
        "CSPACE_API_TRUSTED_PROXIES": "10.0.0.0/8",
        "CSPACE_API_MAX_CONNECTIONS": "7",
        "CSPACE_API_HEADER_TIMEOUT_S": "1.5",
        "CSPACE_API_WRITE_TIMEOUT_S": "2.5",
        "CSPACE_API_GRACE_S": "3",
        "CSPACE_API_GUIDE": "/srv/guide",
        "CSPACE_API_WORKBENCH": "1",
        "CSPACE_API_MLFLOW_PAGES": "http://127.0.0.1:5000/",
        "CSPACE_API_LOAD_PLANNER": "0",
        "CSPACE_OUTCOMES": "/srv/outcomes",
        "CSPACE_OUTCOMES_MIB": "16",
        "CSPACE_OUTCOMES_KEEP_DAYS": "30",
    }
    protection = Protection(
        keys_file=Path("/srv/keys"),
        max_in_flight=5,
        body_timeout_s=4.5,
        rate_per_s=6.5,
        rate_burst=11,
        held_body_bytes=9 * 2**20,
        hosts=("api", "[::1]"),
        origins=("https://site.example",),
        trusted_proxies=("10.0.0.0/8",),
    )
    assert ApiSettings.from_environment(environment) == ApiSettings(
        registry_uri="http://127.0.0.1:5000",
        cache_folder=Path("/srv/models"),
        model_name="a.b_c-d",
        poll_s=0.5,
        pretrained_folder=Path("/srv/shipped"),
        loaded_bundles=7,
        cached_pictures=9,
        threads=3,
        protection=protection,
        stored_bundles=8,
        connections=ConnectionLimits(connections=7, header_timeout_s=1.5, write_timeout_s=2.5),
        grace_s=3,
        guide_folder=Path("/srv/guide"),
        workbench=True,
        mlflow_pages="http://127.0.0.1:5000",
        load_planner=False,
        outcomes_folder=Path("/srv/outcomes"),
        outcomes_bytes=16 * 2**20,
        kept_pictures_days=30.0,
    )


def test_lists_of_names_are_read() -> None:
    names = {
        "CSPACE_API_HOSTS": " api, 10.0.0.1,::1,[::2],*,",
        "CSPACE_API_ORIGINS": "https://a.example:8443,http://[::1]:1",
        "CSPACE_API_TRUSTED_PROXIES": "10.0.0.0/8, ::1",
    }
    read = ApiSettings.from_environment(names).protection
    assert read.hosts == ("api", "10.0.0.1", "[::1]", "[::2]", "*")
    assert read.origins == ("https://a.example:8443", "http://[::1]:1")
    assert read.trusted_proxies == ("10.0.0.0/8", "::1")
    assert ApiSettings.from_environment(dict.fromkeys(names, "")).protection == Protection()


@pytest.mark.parametrize(
    ("environment", "traces"),
    [
        ({}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:4318"}, True),
        ({"OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "http://127.0.0.1:4318/v1/traces"}, True),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:4318", "OTEL_SDK_DISABLED": "true"}, False),
    ],
)
def test_opentelemetrys_own_variables_decide(environment: dict[str, str], traces: bool) -> None:
    assert ApiSettings.from_environment(environment).traces is traces


WRONG = {
    "CSPACE_MODEL_NAME": ("../m", "m/1", "m@champion", ".m", "a" * 101, "pretrained", "m\n"),
    "CSPACE_MODEL_POLL_S": ("0", "nan", "inf", "soon"),
    "CSPACE_LOADED_MODELS": ("0",),
    "CSPACE_API_THREADS": ("0",),
    "CSPACE_STORED_MODELS": ("0",),
    "CSPACE_API_MAX_CONNECTIONS": ("0",),
    "CSPACE_API_HEADER_TIMEOUT_S": ("0",),
    "CSPACE_API_WRITE_TIMEOUT_S": ("0",),
    "CSPACE_API_GRACE_S": ("0",),
    "CSPACE_API_HELD_BODIES_MIB": ("7",),
    "CSPACE_API_HOSTS": ("http://api", "api:80", "a b"),
    "CSPACE_API_ORIGINS": ("site.example", "https://site.example/", "*"),
    "CSPACE_API_TRUSTED_PROXIES": ("*", "proxy.example", "10.0.0.1/8"),
    "CSPACE_API_WORKBENCH": ("yes",),
    "CSPACE_OUTCOMES_MIB": ("15", "inf"),
    "CSPACE_OUTCOMES_KEEP_DAYS": ("-1", "nan", "4000"),
    "CSPACE_API_MLFLOW_PAGES": ("javascript:alert(1)",),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_setting_is_an_error_that_names_it(name: str) -> None:
    for value in WRONG[name]:
        with pytest.raises(ConfigError, match=name):
            ApiSettings.from_environment({name: value})
