"""A database of an older MLflow is brought to the schema of this one before the server starts."""

from pathlib import Path

import mlflow
import pytest

from tests.compose.stack import Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(1800)]

# The database as the release before the last change of the schema would have left it.
OLDER = """
import sys
from alembic import command
from alembic.script import ScriptDirectory
from mlflow.store.db.utils import InitialBase, _get_alembic_config, create_sqlalchemy_engine_with_retry

engine = create_sqlalchemy_engine_with_retry(sys.argv[1])
InitialBase.metadata.create_all(engine)
config = _get_alembic_config(sys.argv[1])
head = ScriptDirectory.from_config(config).get_revision("head")
with engine.begin() as connection:
    config.attributes["connection"] = connection
    command.upgrade(config, head.down_revision)
print(head.down_revision, head.revision)
"""
URI = "postgresql+psycopg2://mlflow@postgres:5432/mlflow"


def revision(stack: Stack) -> str:
    query = ("--tuples-only", "--no-align", "--command", "SELECT version_num FROM alembic_version")
    return stack.compose("exec", "-T", "postgres", "psql", "--username=mlflow", *query, "mlflow").strip()


def test_an_older_schema_is_migrated(stack: Stack, root: Path) -> None:
    # The other stack has built the images.
    with Stack.lent(root) as old:
        old.compose("up", "--no-build", "--wait", "postgres")
        made = old.compose("run", "--rm", "--no-deps", "-T", "mlflow", "python", "-c", OLDER, URI)
        before, head = made.split()[-2:]
        assert (revision(old), before != head) == (before, True)
        # By itself and twice: the server would bring some of the changes along on its own, and refuse others.
        for _ in range(2):
            old.compose("run", "--rm", "-T", "mlflow-migrate")
            assert revision(old) == head
        old.compose("up", "--no-build", "--wait", "mlflow")
        (experiment,) = mlflow.MlflowClient(old.url("MLFLOW")).search_experiments()
        assert experiment.name == "Default"
