"""What the compose tests share: the repository, the parsed compose file, the engine of this machine."""

import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def compose_file() -> dict[str, Any]:
    parsed = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
    assert isinstance(parsed, dict)
    return parsed


@pytest.fixture(scope="session")
def services(compose_file: Mapping[str, Any]) -> Mapping[str, Any]:
    found = compose_file["services"]
    assert isinstance(found, dict)
    return found


@pytest.fixture(scope="session")
def long_running(services: Mapping[str, Any]) -> Mapping[str, Any]:
    """The services that `docker compose up` starts; one-shot jobs carry a profile."""
    return {name: service for name, service in services.items() if "profiles" not in service}


def succeeds(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False, timeout=30).returncode == 0
    except FileNotFoundError:
        return False


@pytest.fixture(scope="session")
def compose_v2() -> None:
    """Skip without Compose v2: the older tool reads another language."""
    if not succeeds("docker", "compose", "version"):
        pytest.skip("docker compose v2 is not installed")


@pytest.fixture(scope="session")
def engine(compose_v2: None) -> None:
    if not succeeds("docker", "version"):
        pytest.skip("no container engine answers")
