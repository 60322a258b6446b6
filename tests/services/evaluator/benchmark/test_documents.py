import re
from pathlib import Path

import pytest

from services.evaluator.benchmark.runs import PLAN_COLUMNS, SAMPLE_COLUMNS

TEXT = (Path(__file__).parents[4] / "docs" / "benchmark.md").read_text("utf-8")


@pytest.mark.parametrize(("number", "columns"), [(0, SAMPLE_COLUMNS), (1, PLAN_COLUMNS)])
def test_the_document_describes_the_columns_of_each_table_in_their_order(number, columns):
    _, *tables = TEXT.split("| column | content |")
    rows = re.findall(r"^\| `(\w+)` \| \S.* \|$", tables[number], re.MULTILINE)
    assert rows == list(columns)
