from pathlib import Path

import pytest

from cspace.errors import ConfigError
from inference_api.settings import PRETRAINED_FOLDER, ApiSettings


def test_an_empty_environment_serves_the_shipped_model_from_defaults() -> None:
    settings = ApiSettings.from_environment({"XDG_CACHE_HOME": "/var/cache/user"})
    assert settings == ApiSettings(None, Path("/var/cache/user/cspace-sampler/models"))
    assert PRETRAINED_FOLDER.parent.name == "inference_api"


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
    ],
)
def test_a_wrong_setting_is_an_error_that_names_it(name: str, value: str) -> None:
    with pytest.raises(ConfigError, match=name):
        ApiSettings.from_environment({name: value})
