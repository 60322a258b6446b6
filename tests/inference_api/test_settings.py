from ipaddress import ip_network
from pathlib import Path

import pytest

from cspace.errors import ConfigError
from inference_api.settings import ApiSettings, further_folders
from services.commands import settings_of
from services.registry.entities import PRETRAINED, SHIPPED

READ = {
    "MLFLOW_TRACKING_URI": ("http://127.0.0.1:5000", "registry_uri", "http://127.0.0.1:5000"),
    "CSPACE_MODEL_CACHE": ("/srv/models", "model_cache", Path("/srv/models")),
    "CSPACE_MODEL_NAME": ("a.b_c-d", "model_name", "a.b_c-d"),
    "CSPACE_MODEL_POLL_S": ("0.5", "model_poll_s", 0.5),
    "CSPACE_PRETRAINED_MODEL": ("/srv/shipped", "shipped_folders", {PRETRAINED: Path("/srv/shipped")}),
    "CSPACE_API_THREADS": ("3", "api_threads", 3),
    "CSPACE_API_KEYS_FILE": ("/srv/keys", "api_keys_file", Path("/srv/keys")),
    "CSPACE_API_HOSTS": (" api, ::1,[::2],*,", "api_hosts", ("api", "[::1]", "[::2]", "*")),
    "CSPACE_API_ORIGINS": ("https://a.example:8443", "api_origins", ("https://a.example:8443",)),
    "CSPACE_API_TRUSTED_PROXIES": ("10.0.0.0/8", "api_trusted_proxies", (ip_network("10.0.0.0/8"),)),
    "CSPACE_API_WORKBENCH": ("1", "api_workbench", True),
    "CSPACE_API_LOAD_PLANNER": ("0", "api_load_planner", False),
    "CSPACE_OUTCOMES": ("/srv/outcomes", "outcomes", Path("/srv/outcomes")),
}  # fmt: skip


def test_settings_are_read_from_variables_and_an_empty_one_counts_as_unset(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/var/cache/user")
    # Only the project's names count.
    monkeypatch.setenv("API_THREADS", "99")
    defaults = settings_of(ApiSettings)
    assert defaults.model_cache == Path("/var/cache/user/cspace-sampler/models")
    assert set(defaults.shipped_folders) == {PRETRAINED, *further_folders()} == set(SHIPPED)
    for name in READ:
        monkeypatch.setenv(name, "")
    assert settings_of(ApiSettings) == defaults
    for name, (text, _, _) in READ.items():
        monkeypatch.setenv(name, text)
    found = settings_of(ApiSettings)
    for _, field, value in READ.values():
        assert getattr(found, field) == value
        assert getattr(found, field) != getattr(defaults, field)


WRONG = {
    "CSPACE_MODEL_NAME": ("../m", "m/1", "m@champion", ".m", "a" * 101, "pretrained", "m\n"),
    "CSPACE_MODEL_POLL_S": ("0", "nan", "inf", "soon"),
    "CSPACE_API_THREADS": ("0",),
    "CSPACE_API_HOSTS": ("http://api", "api:80", "a b"),
    "CSPACE_API_ORIGINS": ("site.example", "https://site.example/", "*"),
    "CSPACE_API_TRUSTED_PROXIES": ("*", "proxy.example", "10.0.0.1/8"),
    "CSPACE_API_WORKBENCH": ("perhaps",),
    "CSPACE_OUTCOMES_MIB": ("15", "inf"),
    "CSPACE_TRUSTED_KEY": ("/nothing",),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_setting_is_an_error_that_names_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for value in WRONG[name]:
        monkeypatch.setenv(name, value)
        with pytest.raises(ConfigError, match=name):
            settings_of(ApiSettings)
