"""What is written is there whole or not at all."""

import json
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from cspace.errors import JobError, StorageError
from cspace.files import holding, replacing


def test_a_file_takes_the_place_of_the_one_that_was_there(tmp_path: Path) -> None:
    target = tmp_path / "record.json"
    for number in (1, 2):
        with replacing(target) as beside:
            beside.write_text(json.dumps({"number": number}))
        assert json.loads(target.read_text()) == {"number": number}
    assert list(tmp_path.iterdir()) == [target]


def interrupted(target: Path, error: BaseException, folder: bool) -> None:
    with replacing(target) as beside:
        if folder:
            beside.mkdir()
        (beside / "half" if folder else beside).write_text("ha")
        raise error


@pytest.mark.parametrize(
    ("error", "folder"), [(KeyboardInterrupt(), True), (OSError(28, "No space left"), False)]
)
def test_what_is_interrupted_leaves_nothing(tmp_path: Path, error: BaseException, folder: bool) -> None:
    with pytest.raises(type(error)):
        interrupted(tmp_path / "new", error, folder)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "text").write_text("years of work")
    refused = pytest.raises(StorageError, match="the thesis cannot be written")
    with refused, replacing(tmp_path / "thesis", "the thesis") as beside:
        beside.mkdir()
    assert (tmp_path / "thesis" / "text").read_text() == "years of work"
    assert [path.name for path in tmp_path.iterdir()] == ["thesis"]


def test_a_lock_file_is_held_by_one_at_a_time_and_given_back_after_an_error(tmp_path: Path) -> None:
    path, busy = tmp_path / "lock", JobError("held")
    with suppress(ZeroDivisionError), holding(path, busy):
        with pytest.raises(JobError, match="held"), holding(path, busy):
            pytest.fail("two hold it")
        raise ZeroDivisionError
    with holding(path, busy):
        assert path.is_file()


def test_whoever_waits_for_a_lock_gets_it_when_it_is_free(tmp_path: Path) -> None:
    path, held = tmp_path / "lock", threading.Event()

    def hold() -> None:
        with holding(path, JobError("held")):
            held.set()
            time.sleep(0.2)

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait(60)
    with holding(path, JobError("held"), wait_s=60.0):
        pass
    thread.join()
