import re
from pathlib import Path

from services.evaluator.benchmark.job import COLUMNS

TEXT = (Path(__file__).parents[4] / "docs" / "benchmark.md").read_text("utf-8")


def test_the_document_describes_the_columns_of_the_table_in_their_order():
    _, table = TEXT.split("| column | content |")
    assert re.findall(r"^\| `(\w+)` \| \S.* \|$", table, re.MULTILINE) == list(COLUMNS)
