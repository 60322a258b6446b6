"""The commit of a checkout, of an uploaded copy, and of sources without history."""

import shutil
import subprocess
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from training.jobs.provenance import UNKNOWN, SourceState, command_line, source_state


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=t", "-c", "user.email=t@example.org"]
    done = subprocess.run(
        ["git", "-C", str(folder), *who, *arguments],  # noqa: S607 - git is found where the user has it
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with a module at training/jobs/provenance.py and a file that uploads leave out."""
    root = tmp_path / "checkout"
    for name in ("training/jobs/provenance.py", "tests/large.txt"):
        (root / name).parent.mkdir(parents=True)
        (root / name).write_text("as committed\n")
    git(root, "init", "--quiet")
    git(root, "add", ".")
    git(root, "commit", "--quiet", "--message", "first")
    for name in ("CSPACE_GIT_DIR", "CSPACE_GIT_COMMIT"):
        monkeypatch.delenv(name, raising=False)
    return root


@pytest.fixture
def copy(checkout: Path, tmp_path: Path) -> Path:
    """An upload of the checkout."""
    root = tmp_path / "copy"
    shutil.copytree(checkout / "training", root / "training")
    return root


def test_a_checkout_tells_commit_and_changes(checkout: Path) -> None:
    commit = git(checkout, "rev-parse", "HEAD")
    assert source_state(checkout) == SourceState(commit, dirty=False)
    (checkout / "tests" / "large.txt").write_text("changed\n")
    assert source_state(checkout) == SourceState(commit, dirty=True)


def test_an_uploaded_copy_is_compared_with_the_history_it_came_from(
    checkout: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CSPACE_GIT_DIR", str(checkout / ".git"))
    commit = git(checkout, "rev-parse", "HEAD")
    assert source_state(copy) == SourceState(commit, dirty=False)
    (copy / "training" / "jobs" / "provenance.py").write_text("changed\n")
    assert source_state(copy) == SourceState(commit, dirty=True)
    assert git(checkout, "status", "--porcelain") == ""


@pytest.mark.parametrize("history", ["", "/nowhere/.git"])
def test_without_history_the_environment_names_the_commit(
    history: str, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CSPACE_GIT_DIR", history)
    assert source_state(copy) == SourceState(UNKNOWN, None)
    monkeypatch.setenv("CSPACE_GIT_COMMIT", "abc")
    assert source_state(copy) == SourceState("abc", None)


@pytest.mark.parametrize(
    ("spec", "program", "expected"),
    [
        (None, "training/x.py", "training/x.py"),
        (None, str(Path(__file__).parents[3] / "training" / "x.py"), "training/x.py"),
        ("training.path_sampler", "/a/b/training/path_sampler.py", "-m training.path_sampler"),
        ("services.evaluator.__main__", "/a/b/__main__.py", "-m services.evaluator"),
    ],
)
def test_the_command_names_no_folder_of_the_machine(
    spec: str | None, program: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", spec and ModuleSpec(spec, None))
    monkeypatch.setattr(sys, "argv", [program, "--preset", "smoke"])
    assert command_line() == f"python {expected} --preset smoke"
