"""What docs/operations.md says of MLflow's database, on databases that an older MLflow wrote."""

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contracts.mlflow_server import MlflowServer

pytestmark = [pytest.mark.e2e, pytest.mark.slow]

OLDER = "17e22815139b"
UNKNOWN = "ffffffffffff"
WRITE = """
import sys
import sqlalchemy
from alembic import command
from mlflow.store.db.utils import InitialBase, _get_alembic_config
url, revision = sys.argv[1:]
engine = sqlalchemy.create_engine(url)
InitialBase.metadata.create_all(engine)
config = _get_alembic_config(url)
with engine.begin() as connection:
    config.attributes["connection"] = connection
    command.upgrade(config, revision)
"""


def run(*command: str) -> None:
    environment = os.environ | {"MLFLOW_DISABLE_TELEMETRY": "true"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def ask(database: Path, statement: str) -> list[tuple[str, ...]]:
    connection = sqlite3.connect(database)
    try:
        found = connection.execute(statement).fetchall()
        connection.commit()
        return found
    finally:
        connection.close()


def revision(database: Path) -> str:
    return ask(database, "SELECT version_num FROM alembic_version")[0][0]


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """A state folder's part for MLflow, as an older MLflow left it, with one experiment."""
    folder = tmp_path / "state"
    folder.mkdir()
    database = folder / "mlflow.db"
    run(sys.executable, "-c", WRITE, f"sqlite:///{database}", OLDER)
    ask(database, "INSERT INTO experiments (name, lifecycle_stage) VALUES ('kept', 'active')")
    assert revision(database) == OLDER
    return folder


def starts(folder: Path) -> bool:
    """Whether a server comes up on a folder; what it says is in the folder's log."""
    server = MlflowServer(folder)
    try:
        server.start()
    except RuntimeError:
        return False
    server.end()
    return True


def test_a_database_that_lacks_tables_is_brought_along_as_the_server_starts(state: Path) -> None:
    assert starts(state)
    assert revision(state / "mlflow.db") != OLDER
    assert ("kept",) in ask(state / "mlflow.db", "SELECT name FROM experiments")


def test_a_database_is_brought_along_by_hand_and_the_way_back_is_the_copy(
    state: Path, tmp_path: Path
) -> None:
    database, copy = state / "mlflow.db", tmp_path / "before"
    run("cp", "--archive", str(state), str(copy))
    run(str(Path(sys.executable).parent / "mlflow"), *["db", "upgrade"], f"sqlite:///{database}")
    head = revision(database)
    assert head != OLDER
    assert starts(state)
    assert ("kept",) in ask(database, "SELECT name FROM experiments")
    # All tables are there, and the schema is another one: older, or from the future.
    for other in (OLDER, UNKNOWN):
        ask(database, f"UPDATE alembic_version SET version_num = '{other}'")  # noqa: S608
        assert not starts(state)
        assert "Detected out-of-date database schema" in (state / "server.log").read_text(encoding="utf-8")
    run("rm", "-r", str(state))
    run("mv", str(copy), str(state))
    assert revision(database) == OLDER
    assert ("kept",) in ask(database, "SELECT name FROM experiments")
