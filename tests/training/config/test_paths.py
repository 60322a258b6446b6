import pytest

from training.config import load_path_config
from training.path_train import COMMAND


@pytest.mark.parametrize(
    ("key", "path"), [("data_folder", "mine"), ("guides", "jobs/1"), ("source", "build/bundle")]
)
def test_a_path_that_is_not_absolute_is_refused_before_anything_starts(
    key: str, path: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert COMMAND.main(["--set", f"{key}={path}", "--print-config"]) == 2
    message = capsys.readouterr().err
    assert f"{key} does not fit" in message
    assert "absolute" in message


@pytest.mark.parametrize("source", ["panda-sampler@champion", "cspace-sampler/3", "/somewhere/bundle"])
def test_a_source_is_a_registered_version_or_an_absolute_folder(source: str) -> None:
    assert load_path_config("paths", [f"source={source}"]).source == source
