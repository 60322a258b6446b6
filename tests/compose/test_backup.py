"""Backup and restore by the commands that docs/containers.md gives: pg_dump, pg_restore, artifacts.tar.gz."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from services.names import ALIAS_CHAMPION
from tests.compose.answers import ask_for_samples, serves_champion
from tests.compose.documented import run_documented
from tests.compose.kept import Kept, downloaded_digest
from tests.compose.stack import Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]


def test_a_fresh_stack_has_all_that_was_backed_up(
    stack: Stack, decided: Mapping[str, Any], root: Path, tmp_path: Path
) -> None:
    backup = tmp_path / "backup"
    run_documented(stack, "pg_dump ", backup)
    kept, samples = Kept.by(stack), ask_for_samples(stack).json()["samples"]
    assert kept.versions
    with Stack.lent(root) as fresh:
        run_documented(fresh, "pg_restore ", backup)
        assert Kept.by(fresh) == kept
        assert downloaded_digest(fresh, ALIAS_CHAMPION, tmp_path) == decided["digest"]
        serves_champion(fresh, decided)
        answer = ask_for_samples(fresh).json()
        assert (answer["model"]["digest"], answer["samples"]) == (decided["digest"], samples)


def test_a_restore_over_a_database_that_is_in_use_changes_nothing(
    stack: Stack, decided: Mapping[str, Any], tmp_path: Path
) -> None:
    backup = tmp_path / "backup"
    run_documented(stack, "pg_dump ", backup)
    kept = Kept.by(stack)
    with pytest.raises(AssertionError, match="already exists"):
        run_documented(stack, "pg_restore ", backup)
    assert Kept.by(stack) == kept
