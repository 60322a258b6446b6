"""New secrets by the commands that docs/containers.md gives."""

import secrets
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from tests.compose.documented import run_documented
from tests.compose.kept import Kept
from tests.compose.stack import Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

CHANGED = ("CSPACE_POSTGRES_PASSWORD", "CSPACE_RAY_TOKEN")


def jobs_status(stack: Stack, token: str) -> int:
    headers = {"Authorization": f"Bearer {token}"}
    return httpx.get(f"{stack.url('RAY')}/api/jobs/", headers=headers, timeout=30).status_code


def test_new_secrets_replace_the_old_ones(stack: Stack, untrained: httpx.Response, tmp_path: Path) -> None:
    kept = Kept.by(stack)
    changed: Mapping[str, str] = {name: secrets.token_hex(32) for name in CHANGED}
    renewed = replace(stack, environment={**stack.environment, **changed})
    try:
        run_documented(renewed, "ALTER ROLE", tmp_path)
        assert Kept.by(renewed) == kept
        assert jobs_status(renewed, changed["CSPACE_RAY_TOKEN"]) == 200
        assert jobs_status(renewed, stack.environment["CSPACE_RAY_TOKEN"]) in {401, 403}
    finally:
        # The other tests know the old ones.
        run_documented(stack, "ALTER ROLE", tmp_path)
    assert Kept.by(stack) == kept
