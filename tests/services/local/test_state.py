from pathlib import Path

import pytest

from cspace.errors import ConfigError, StorageError
from services.local.settings import MARKER, Settings, drop_state, size_text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 B"), (999, "999 B"), (1500, "2 kB"), (12_000_000, "12 MB"), (3_210_000_000, "3.2 GB")],
)
def test_sizes_are_told_in_units_for_people(count: int, text: str) -> None:
    assert size_text(count) == text


def test_dropping_the_state_deletes_its_parts_and_the_empty_folder(settings: Settings) -> None:
    (settings.home / "mlflow" / "mlflow.db").touch()
    drop_state(settings)
    assert not settings.home.exists()
    drop_state(settings)


def test_what_somebody_else_put_into_the_state_folder_stays(settings: Settings) -> None:
    (settings.home / "thesis.tex").touch()
    drop_state(settings)
    assert [path.name for path in settings.home.iterdir()] == ["thesis.tex"]


def test_state_that_cannot_be_deleted_is_a_storage_error(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(path)

    monkeypatch.setattr("services.local.settings.shutil.rmtree", refuse)
    with pytest.raises(StorageError):
        drop_state(settings)


def test_only_what_the_mark_lists_is_deleted(settings: Settings) -> None:
    (settings.home / MARKER).write_text('{"parts": ["mlflow", "thesis", "../elsewhere"]}')
    (settings.home / "thesis").mkdir()
    (settings.home.parent / "elsewhere").mkdir()
    drop_state(settings)
    assert not (settings.home / "mlflow").exists()
    assert {"data", "thesis"} <= {path.name for path in settings.home.iterdir()}
    assert (settings.home.parent / "elsewhere").is_dir()


def test_a_folder_that_somebody_else_made_is_left_alone(settings: Settings) -> None:
    (settings.home / MARKER).unlink()
    for refused in (settings.make_folders, lambda: drop_state(settings)):
        with pytest.raises(ConfigError, match="not a state folder"):
            refused()
    assert (settings.home / "data").is_dir()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"parts": 3}'])
def test_a_damaged_mark_allows_nothing(settings: Settings, text: str) -> None:
    (settings.home / MARKER).write_text(text)
    with pytest.raises(ConfigError, match=MARKER):
        drop_state(settings)
    assert (settings.home / "data").is_dir()
