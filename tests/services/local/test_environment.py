import os
import subprocess
import sys
from pathlib import Path

from services.local.settings import Settings, service_environment, shell_lines, without_proxy

BASE = {
    "HOME": "/home/anna",
    "PATH": "/usr/bin",
    "LANG": "C",
    "RAY_ADDRESS": "http://elsewhere:8265",
    "RAY_AUTH_MODE": "disabled",
    "RAY_AUTH_TOKEN_PATH": "/home/anna/token",
    "MLFLOW_TRACKING_URI": "http://elsewhere",
    "MLFLOW_TRACKING_TOKEN": "secret",
}


def test_jobs_find_tracking_data_token_mode_and_one_thread(settings: Settings) -> None:
    environment = service_environment(settings, BASE)
    expected = {
        "MLFLOW_TRACKING_URI": settings.mlflow_url,
        "CSPACE_DATA_DIR": str(settings.data_folder),
        "CSPACE_MODEL_CACHE": str(settings.home / "models"),
        "CSPACE_OUTCOMES": str(settings.data_folder / "outcomes"),
        "RAY_AUTH_MODE": "token",
        "RAY_USAGE_STATS_ENABLED": "0",
        "MLFLOW_DISABLE_TELEMETRY": "true",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(settings.root),
        "HOME": "/home/anna",
        "LANG": "C",
    }
    assert expected.items() <= environment.items()
    assert Path(environment["CSPACE_DATA_DIR"]).is_absolute()
    assert service_environment(settings, BASE | {"CSPACE_OUTCOMES": ""})["CSPACE_OUTCOMES"] == ""
    assert environment["PATH"].split(os.pathsep) == [str(Path(sys.executable).parent), "/usr/bin"]


def test_what_the_shell_says_about_other_clusters_is_dropped_but_not_the_token(settings: Settings) -> None:
    environment = service_environment(settings, BASE)
    assert "RAY_ADDRESS" not in environment
    assert "MLFLOW_TRACKING_TOKEN" not in environment
    assert environment["RAY_AUTH_TOKEN_PATH"] == BASE["RAY_AUTH_TOKEN_PATH"]


def test_loopback_is_behind_no_proxy_and_other_exceptions_stay() -> None:
    assert without_proxy({"NO_PROXY": "intranet"})["NO_PROXY"] == "intranet,127.0.0.1,localhost"
    assert without_proxy({"no_proxy": "localhost"})["no_proxy"] == "localhost,127.0.0.1"


def test_the_shell_lines_do_in_a_shell_what_they_say(settings: Settings) -> None:
    script = "\n".join([*shell_lines(settings), "env"])
    shell = subprocess.run(
        ["/bin/sh", "-c", script], env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, check=True
    )
    values = dict(line.split("=", 1) for line in shell.stdout.splitlines() if "=" in line)
    assert values["RAY_AUTH_MODE"] == "token"
    assert values["RAY_ADDRESS"] == settings.ray_url
    assert values["MLFLOW_TRACKING_URI"] == settings.mlflow_url
    assert values["CSPACE_API_URL"] == settings.api_url
    assert values["CSPACE_OUTCOMES"] == str(settings.data_folder / "outcomes")
    # MLflow prints addresses among the evaluator's results otherwise.
    assert values["MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT"] == "true"
    assert values["PATH"] == f"{Path(sys.executable).parent}:/usr/bin:/bin"
