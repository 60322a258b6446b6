from dataclasses import replace
from pathlib import Path

import pytest

from cspace.errors import ServiceError
from services.local.processes import ProcessId, Record, drop_record, read_record, write_record

RECORD = Record(
    "ray",
    12,
    1.5,
    ("ray", "start"),
    "ray-x",
    "/checkout",
    "http://127.0.0.1:8265",
    "/log",
    (ProcessId(13, 2.5),),
)


def test_a_record_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_record(tmp_path, RECORD)
    assert read_record(tmp_path, "ray") == RECORD


def test_a_new_record_replaces_the_old_one_and_leaves_no_other_file(tmp_path: Path) -> None:
    write_record(tmp_path, RECORD)
    write_record(tmp_path, replace(RECORD, pid=13))
    found = read_record(tmp_path, "ray")
    assert found is not None
    assert found.pid == 13
    assert [path.name for path in tmp_path.iterdir()] == ["ray.json"]


def test_a_service_without_a_record_has_none(tmp_path: Path) -> None:
    assert read_record(tmp_path, "ray") is None
    assert read_record(tmp_path / "absent", "ray") is None


def test_a_dropped_record_is_gone_and_may_be_dropped_again(tmp_path: Path) -> None:
    write_record(tmp_path, RECORD)
    drop_record(tmp_path, "ray")
    drop_record(tmp_path, "ray")
    assert read_record(tmp_path, "ray") is None


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"pid": 1}', '{"argv": 3}'])
def test_a_damaged_record_is_an_error_that_names_the_file(tmp_path: Path, text: str) -> None:
    (tmp_path / "ray.json").write_text(text, encoding="utf-8")
    with pytest.raises(ServiceError, match=r"ray\.json"):
        read_record(tmp_path, "ray")
