from pathlib import Path

from services.evaluator.benchmark.arms import Group
from services.evaluator.benchmark.runs import PLAN_COLUMNS, SAMPLE_COLUMNS

TEXT = (Path(__file__).parents[4] / "docs" / "benchmark.md").read_text("utf-8")


def test_the_document_names_every_column_as_the_table_has_it():
    for columns in (SAMPLE_COLUMNS, PLAN_COLUMNS):
        for name, (_, what) in columns.items():
            assert f"| `{name}` | {what} |" in TEXT


def test_the_document_names_every_group_of_arms():
    for group in Group:
        assert f"| `{group}` |" in TEXT
