from pathlib import Path

from services.evaluator.benchmark.arms import Group
from services.evaluator.benchmark.plans.setting import PlanRun
from services.evaluator.benchmark.store import DESCRIPTIONS, descriptions

TEXT = (Path(__file__).parents[4] / "docs" / "benchmark.md").read_text("utf-8")


def test_the_document_names_every_column_as_the_table_has_it():
    for name, what in (*DESCRIPTIONS.items(), *descriptions(PlanRun).items()):
        assert f"| `{name}` | {what} |" in TEXT


def test_the_document_names_every_group_of_arms():
    for group in Group:
        assert f"| `{group}` |" in TEXT
