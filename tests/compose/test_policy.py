"""What the project asks of its compose file and images beyond the specification."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

OWN_IMAGE = "cspace-sampler/"
SETTING = re.compile(r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?\}")
DOCKERFILES = sorted((Path(__file__).parents[2] / "docker").glob("*.Dockerfile"))


def test_the_stack_is_the_documented_one(
    services: Mapping[str, Any], long_running: Mapping[str, Any]
) -> None:
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


def test_every_dependency_waits_for_health(services: Mapping[str, Any]) -> None:
    for service in services.values():
        for condition in service.get("depends_on", {}).values():
            assert condition == {"condition": "service_healthy"}


def test_the_api_is_healthy_when_it_is_live(services: Mapping[str, Any]) -> None:
    assert "/health/live" in " ".join(services["inference-api"]["healthcheck"]["test"])


def test_every_service_has_a_memory_limit_and_gains_no_privileges(services: Mapping[str, Any]) -> None:
    for service in services.values():
        assert service["mem_limit"]
        assert service["security_opt"] == ["no-new-privileges:true"]


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
    assert re.findall(r"^USER (\S+)", text, re.MULTILINE)[-1] != "root"
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
