"""Writing a data set: whole or not at all, and never over anything."""

from typing import NamedTuple

import pytest

from cspace.dataset import write_dataset
from cspace.errors import StorageError
from tests.dataset_content import content


class DiskUsage(NamedTuple):
    total: int
    used: int
    free: int


def test_a_full_disk_is_told_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr("cspace.dataset.shutil.disk_usage", lambda path: DiskUsage(2**40, 2**40, 1000))
    with pytest.raises(StorageError, match=r"too full.*MiB.*another folder"):
        write_dataset(tmp_path / "data", **content())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_exists_is_never_touched(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "thesis.txt").write_text("years of work")
    with pytest.raises(StorageError, match="exists"):
        write_dataset(tmp_path / "data", **content())
    assert (tmp_path / "data" / "thesis.txt").read_text() == "years of work"
