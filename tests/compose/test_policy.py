"""What the project asks of its compose file and images beyond the specification."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

OWN_IMAGE = "cspace-sampler/"
SETTING = re.compile(r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?\}")
DOCKERFILES = sorted((Path(__file__).parents[2] / "docker").glob("*.Dockerfile"))


MIB = {"m": 1, "g": 1024}


def memory_mib(service: Mapping[str, Any]) -> int:
    """The limit of a service by default, in MiB."""
    limit = SETTING.sub(lambda found: found["default"], service["mem_limit"])
    return int(limit[:-1]) * MIB[limit[-1]]


def test_the_stack_is_the_documented_one(
    services: Mapping[str, Any], long_running: Mapping[str, Any], one_shot: set[str]
) -> None:
    assert one_shot == {"mlflow-migrate"}
    assert set(long_running) == {"postgres", "mlflow", "ray-head", "ray-worker", "inference-api"}
    assert {name for name, service in services.items() if service.get("profiles") == ["jobs"]} == {
        "train",
        "evaluate",
    }


def test_every_published_port_is_on_loopback_and_can_be_changed(services: Mapping[str, Any]) -> None:
    published = [port for service in services.values() for port in service.get("ports", [])]
    assert len(published) == 3
    for port in published:
        assert re.fullmatch(r"127\.0\.0\.1:\$\{CSPACE_\w+_PORT:-\d+\}:\d+", port)


def test_a_service_that_is_scaled_publishes_nothing_and_has_no_fixed_name(
    services: Mapping[str, Any],
) -> None:
    assert not {"ports", "container_name", "hostname"} & set(services["ray-worker"])


def test_every_long_running_service_has_a_health_check_and_a_restart_policy(
    long_running: Mapping[str, Any],
) -> None:
    for service in long_running.values():
        assert service["healthcheck"]["test"][0] == "CMD"
        assert service["restart"] == "unless-stopped"


def test_every_dependency_waits_for_health_or_for_the_end_of_a_one_shot_service(
    services: Mapping[str, Any], one_shot: set[str]
) -> None:
    for service in services.values():
        for name, condition in service.get("depends_on", {}).items():
            awaited = "service_completed_successfully" if name in one_shot else "service_healthy"
            assert condition == {"condition": awaited}


def test_the_database_is_migrated_before_the_tracking_server_starts(services: Mapping[str, Any]) -> None:
    migration = services["mlflow-migrate"]
    assert migration["command"][:3] == ["mlflow", "db", "upgrade"]
    assert migration["image"] == services["mlflow"]["image"]
    assert f"--backend-store-uri={migration['command'][3]}" in services["mlflow"]["command"]
    assert "mlflow-migrate" in services["mlflow"]["depends_on"]


def test_the_api_is_healthy_when_it_is_live(services: Mapping[str, Any]) -> None:
    assert "/health/live" in " ".join(services["inference-api"]["healthcheck"]["test"])


def test_no_service_gains_rights_or_writes_to_its_root(services: Mapping[str, Any]) -> None:
    for service in services.values():
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert service["cap_drop"] == ["ALL"]
        assert service["read_only"] is True
        # Own images end without root; the database's would start with it.
        assert service["image"].startswith(OWN_IMAGE) or service["user"] != "root"


def test_all_that_runs_at_the_same_time_fits_into_8_gib(
    services: Mapping[str, Any], long_running: Mapping[str, Any], one_shot: set[str]
) -> None:
    jobs = [memory_mib(service) for service in services.values() if "profiles" in service]
    migration = sum(memory_mib(services[name]) for name in one_shot)
    assert sum(map(memory_mib, long_running.values())) + max(jobs) + migration <= 8 * 1024


def test_the_tracking_server_has_no_processes_for_jobs_of_its_own(root: Path) -> None:
    text = (root / "docker" / "mlflow.Dockerfile").read_text(encoding="utf-8")
    assert "MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false" in text


def test_the_file_for_gpus_adds_devices_to_the_ray_nodes_and_nothing_else(
    services: Mapping[str, Any], root: Path
) -> None:
    added = yaml.safe_load((root / "docker-compose.gpu.yml").read_text(encoding="utf-8"))["services"]
    nodes = {name for name, service in services.items() if service.get("command", [])[:2] == ["ray", "start"]}
    assert set(added) == nodes
    for service in added.values():
        (device,) = service["deploy"]["resources"]["reservations"]["devices"]
        assert device["capabilities"] == ["gpu"]
        assert set(service) == {"deploy"}


def test_images_are_pinned_and_own_ones_carry_the_version(services: Mapping[str, Any], root: Path) -> None:
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    for service in services.values():
        name, _, tag = service["image"].partition(":")
        assert tag == version if name.startswith(OWN_IMAGE) else tag not in {"", "latest"}


def test_every_own_image_is_built_once(services: Mapping[str, Any]) -> None:
    built = [service["image"] for service in services.values() if "build" in service]
    assert sorted(built) == sorted(
        {s["image"] for s in services.values() if s["image"].startswith(OWN_IMAGE)}
    )


def test_ray_asks_for_a_token_wherever_it_runs(services: Mapping[str, Any]) -> None:
    nodes = [service for service in services.values() if service["image"].startswith(OWN_IMAGE + "ray")]
    assert len(nodes) == 4
    for node in nodes:
        assert node["environment"]["RAY_AUTH_MODE"] == "token"
        assert node["environment"]["RAY_AUTH_TOKEN"]


def test_the_example_settings_are_the_file_s_settings_with_its_defaults(root: Path) -> None:
    text = (root / "docker-compose.yml").read_text(encoding="utf-8")
    used = {match["name"]: match["default"] or "" for match in SETTING.finditer(text)}
    lines = (root / ".env.example").read_text(encoding="utf-8").splitlines()
    documented = dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))
    assert documented == used


@pytest.mark.parametrize("dockerfile", DOCKERFILES, ids=lambda path: path.name)
def test_dockerfiles_build_on_a_pinned_base_and_end_without_root(dockerfile: Path) -> None:
    text = dockerfile.read_text(encoding="utf-8")
    assert "# syntax" not in text
    assert set(re.findall(r"^FROM (\S+)", text, re.MULTILINE)) == {"python:3.11-slim-bookworm"}
    assert re.findall(r"^USER (\S+)", text, re.MULTILINE)[-1] == "1000"
    assert "-c /tmp/constraints.txt" in text


def test_the_api_image_holds_no_training(root: Path) -> None:
    text = (root / "docker" / "api.Dockerfile").read_text(encoding="utf-8")
    assert re.findall(r"requirements\.py (\w+)", text) == ["api"]
    assert "COPY training" not in text


def test_the_build_context_is_a_list_of_what_goes_in(root: Path) -> None:
    lines = (root / ".dockerignore").read_text(encoding="utf-8").splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    assert rules[0] == "*"
    assert not {"!.", "!.env", "!.git"} & set(rules)
