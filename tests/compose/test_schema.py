"""The compose file is what the Compose Specification allows."""

import json
import os
import subprocess
from pathlib import Path

import jsonschema
import pytest
import yaml


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    text = Path(__file__).with_name("compose-spec.json").read_text(encoding="utf-8")
    return jsonschema.Draft202012Validator(json.loads(text))


@pytest.mark.parametrize("name", ["docker-compose.yml", "docker-compose.gpu.yml"])
def test_the_compose_files_validate(schema: jsonschema.Draft202012Validator, root: Path, name: str) -> None:
    parsed = yaml.safe_load((root / name).read_text(encoding="utf-8"))
    assert [error.message for error in schema.iter_errors(parsed)] == []


@pytest.mark.parametrize("files", ["docker-compose.yml", "docker-compose.yml:docker-compose.gpu.yml"])
@pytest.mark.parametrize("env_file", ["/dev/null", ".env.example"])
def test_compose_itself_accepts_the_files(compose_v2: None, root: Path, env_file: str, files: str) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("CSPACE_")}
    command = ["docker", "compose", "--env-file", env_file, "--profile", "jobs", "config", "--quiet"]
    outcome = subprocess.run(
        command,
        cwd=root,
        env={**environment, "COMPOSE_FILE": files},
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert (outcome.returncode, outcome.stderr) == (0, "")
