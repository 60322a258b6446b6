from pathlib import Path

import numpy as np
import pytest

from cspace.dataset import write_dataset
from cspace.errors import ConfigError
from cspace.worlds import default_world
from services.local.settings import Settings, shell_lines
from services.local.upload import check_upload, require_uploadable, uploaded_bytes

MIB = 2**20


def large(path: Path, mebibytes: float) -> None:
    """A file without content on the disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.truncate(round(mebibytes * MIB))


def test_a_data_set_in_the_working_directory_is_not_uploaded(tmp_path: Path) -> None:
    (tmp_path / "code.py").write_text("pass")
    world = default_world()
    images = np.zeros((3, *world.sensor.picture_shape), dtype=np.uint8)
    free = [np.zeros((2, world.dim))] * 3
    write_dataset(tmp_path / "arm-data", world=world, images=images, free=free, generator={})
    assert list(uploaded_bytes(tmp_path)) == ["code.py"]


def test_the_state_of_the_services_in_the_working_directory_is_not_uploaded(tmp_path: Path) -> None:
    settings = Settings(home=tmp_path / "state", root=tmp_path)
    settings.make_folders()
    large(settings.data_folder / "datasets" / "train" / "images.npy", 200)
    require_uploadable(tmp_path)
    assert not uploaded_bytes(tmp_path)


def test_a_folder_of_the_users_own_stays_part_of_the_upload(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "job.py").write_text("pass")
    Settings(home=tmp_path / "state", root=tmp_path).make_folders()
    assert list(uploaded_bytes(tmp_path)) == ["own"]


def test_the_archive_of_a_folder_is_as_large_as_ray_makes_it(tmp_path: Path) -> None:
    from ray._private.runtime_env.packaging import create_package

    folder, archive = tmp_path / "folder", tmp_path / "archive.zip"
    for name in ("a.py", "deep/er/b.py", "left/out.log"):
        large(folder / name, 0.1)
    (folder / ".rayignore").write_text("*.log")
    create_package(str(folder), archive, include_gitignore=True)
    # Its end, and the entry of a folder that is left without files.
    assert sum(uploaded_bytes(folder).values()) == pytest.approx(archive.stat().st_size, abs=200)


@pytest.mark.parametrize("name", ["recordings/monday/images.npy", "archive.tar"])
def test_a_folder_that_ray_would_not_take_is_refused_with_its_largest_parts(
    tmp_path: Path, name: str
) -> None:
    large(tmp_path / "code.py", 1)
    require_uploadable(tmp_path)
    large(tmp_path / name, 96)
    with pytest.raises(
        ConfigError, match=f"at most 95 MiB; got 97 MiB, of which {Path(name).parts[0]} 96 MiB"
    ):
        require_uploadable(tmp_path)


def test_ray_asks_before_it_uploads(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from click.testing import CliRunner
    from ray.dashboard.modules.job.cli import submit

    (hook,) = (line.partition("=")[2] for line in shell_lines(settings) if "RAY_JOB_SUBMIT_HOOK" in line)
    monkeypatch.setenv("RAY_JOB_SUBMIT_HOOK", hook)
    large(tmp_path / "big" / "images.npy", 200)
    # Nobody listens there: the command ends before it asks.
    command = ["--address", "http://127.0.0.1:1", "--working-dir", str(tmp_path / "big"), "--", "true"]
    result = CliRunner().invoke(submit, command)
    assert result.exit_code == 1
    assert "too large to be uploaded" in str(result.exception)
    assert "images.npy 200 MiB" in str(result.exception)


@pytest.mark.parametrize("working_dir", [None, "https://example.com/code.zip", "/not/there"])
def test_what_is_no_folder_is_left_to_ray(working_dir: str | None) -> None:
    check_upload(working_dir=working_dir, entrypoint=("true",))
