"""What the compose tests share: the repository, the parsed compose file, the engine, one trained stack."""

import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from tests.compose.answers import ask_for_samples, serves_champion
from tests.compose.stack import Stack

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
def one_shot(services: Mapping[str, Any]) -> set[str]:
    """The services that somebody waits for the end of."""
    return {
        name
        for service in services.values()
        for name, condition in service.get("depends_on", {}).items()
        if condition["condition"] == "service_completed_successfully"
    }


@pytest.fixture(scope="session")
def long_running(services: Mapping[str, Any], one_shot: set[str]) -> Mapping[str, Any]:
    """The services that `docker compose up` starts and keeps; jobs carry a profile."""
    return {
        name: service
        for name, service in services.items()
        if "profiles" not in service and name not in one_shot
    }


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


@pytest.fixture(scope="session")
def stack(engine: None, root: Path) -> Iterator[Stack]:
    """One stack for all tests of this folder, as training it takes minutes. Each leaves it running."""
    with Stack.lent(root) as stack:
        stack.up()
        yield stack


@pytest.fixture(scope="session")
def untrained(stack: Stack) -> httpx.Response:
    """What the API answers while the registry is empty."""
    return ask_for_samples(stack)


@pytest.fixture(scope="session")
def trained(stack: Stack, untrained: httpx.Response) -> Mapping[str, Any]:
    """What the training job says of the version that it registered."""
    return stack.result("train")


@pytest.fixture(scope="session")
def decided(stack: Stack, trained: Mapping[str, Any]) -> Mapping[str, Any]:
    """What the evaluation job says of that version, which the API serves from then on, without a restart."""
    started = stack.started_at("inference-api")
    reference = f"{trained['model']}/{trained['version']}"
    decision = stack.result("evaluate", "--model", reference)
    assert decision["promoted"] is True, decision["reasons"]
    serves_champion(stack, decision)
    assert stack.started_at("inference-api") == started
    return decision
