from pathlib import Path

import pytest

from cspace.errors import ServiceError
from services.local.processes import ProcessId, Record, read_record, write_record

RECORD = Record(
    12,
    1.5,
    "ray",
    "ray-x",
    "/checkout",
    "http://127.0.0.1:8265",
    "/log",
    (ProcessId(13, 2.5),),
)


def test_a_record_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_record(tmp_path, RECORD)
    assert read_record(tmp_path, "ray") == RECORD
    assert read_record(tmp_path, "mlflow") is None


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"pid": 1}', '{"children": 3}'])
def test_a_damaged_record_is_an_error_that_names_the_file(tmp_path: Path, text: str) -> None:
    (tmp_path / "ray.json").write_text(text, encoding="utf-8")
    with pytest.raises(ServiceError, match=r"ray\.json"):
        read_record(tmp_path, "ray")
