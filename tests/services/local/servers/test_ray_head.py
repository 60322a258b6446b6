import subprocess
from pathlib import Path

import pytest

from cspace.errors import ServiceStartError
from services.local.settings import (
    MAX_TEMP_PATH,
    Settings,
    ensure_token,
    read_token,
    temp_folder,
    token_headers,
)
from services.local.stack import ray_head


def test_the_head_listens_on_loopback_and_asks_for_the_token(settings: Settings) -> None:
    service = ray_head(settings)
    command = service.command()
    assert {"--node-ip-address=127.0.0.1", "--dashboard-host=127.0.0.1"} <= set(command)
    assert service.environment["RAY_AUTH_MODE"] == "token"
    # Without it the head would listen on the machine's outer address in spite of the options.
    assert service.environment["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] == "0"
    # Jobs without a working directory run there.
    assert service.folder == settings.root


@pytest.mark.parametrize("temporary", ["/a/very/long/folder/for/temporary/files/of/somebody", "/my tmp"])
def test_rays_folder_is_short_enough_for_sockets_and_has_no_space(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, temporary: str
) -> None:
    monkeypatch.setattr("tempfile.tempdir", temporary)
    assert len(str(temp_folder(settings))) <= MAX_TEMP_PATH
    assert " " not in str(temp_folder(settings))


@pytest.mark.parametrize("name", ["a b", "R&D", "it's"])
def test_a_path_below_which_ray_cannot_run_is_refused_before_anything_starts(
    tmp_path: Path, name: str
) -> None:
    root = tmp_path / name / "checkout"
    service = ray_head(Settings(home=tmp_path / "state", root=root))
    with pytest.raises(ServiceStartError, match="move the project"):
        service.prepare()


@pytest.mark.parametrize("name", ["a b", "R&D", "it's", "50$", "a(1)", "tab\t", "a:b"])
def test_make_refuses_such_a_path_before_it_installs(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    assert make_venv(tmp_path / name) == (2, "Ray cannot run below the folder", False)


@pytest.mark.parametrize("name", ["plain", "with-._~+@%,=", "Größe"])
def test_make_takes_every_other_path(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    # It goes on to look for Python, which is not there.
    assert make_venv(tmp_path / name)[1].startswith("Python")


def make_venv(folder: Path) -> tuple[int, str, bool]:
    """``make venv`` without a Python: exit code, start of the message, whether there is a ``.venv``."""
    for name in ("pyproject.toml", "clients/python/pyproject.toml", "constraints.txt"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    makefile = Path(__file__).parents[4] / "Makefile"
    command = ["make", "-s", "-f", str(makefile), "PYTHON=/not/there", "venv"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr[: len("Ray cannot run below the folder")], (folder / ".venv").exists()


def test_state_folders_have_different_ray_folders(settings: Settings, tmp_path: Path) -> None:
    other = Settings(home=tmp_path / "other", root=settings.root)
    assert temp_folder(settings) != temp_folder(other)
    assert temp_folder(settings) == temp_folder(settings)


def test_a_token_is_made_once_for_the_user_alone(tmp_path: Path) -> None:
    environment = {"HOME": str(tmp_path)}
    assert read_token(environment) is None
    assert token_headers(environment) == {}
    ensure_token(environment)
    token = read_token(environment)
    ensure_token(environment)
    assert token is not None
    assert len(token) == 64
    assert read_token(environment) == token
    assert token_headers(environment) == {"Authorization": f"Bearer {token}"}
    path = tmp_path / ".ray" / "auth_token"
    assert path.stat().st_mode & 0o077 == 0
    assert [found.name for found in path.parent.iterdir()] == ["auth_token"]


def test_the_variable_comes_before_the_named_file_before_the_home_folder(tmp_path: Path) -> None:
    ensure_token({"HOME": str(tmp_path)})
    named = tmp_path / "token"
    named.write_text("named\n", encoding="utf-8")
    environment = {"HOME": str(tmp_path), "RAY_AUTH_TOKEN_PATH": str(named)}
    assert read_token(environment) == "named"
    assert read_token({**environment, "RAY_AUTH_TOKEN": "direct"}) == "direct"


def test_a_named_token_file_that_is_missing_is_an_error(tmp_path: Path) -> None:
    environment = {"HOME": str(tmp_path), "RAY_AUTH_TOKEN_PATH": str(tmp_path / "absent")}
    with pytest.raises(ServiceStartError, match="RAY_AUTH_TOKEN_PATH"):
        ensure_token(environment)
