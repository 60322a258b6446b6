"""The planner's outcomes as the main job takes them: a command of another kind stands in for Python."""

import os
from pathlib import Path

import pytest

from cspace.errors import PlanningError
from services.local import quickstart
from services.local.jobs import EvaluationResult, TrainingResult
from services.local.quickstart import TOURS, Progress
from services.local.settings import Settings


def command(folder: Path, script: str) -> str:
    """A program that gets the planner's arguments; the last one is the picture's path."""
    program = folder / "program"
    program.write_text(f"#!/bin/sh\nfor picture; do :; done\n{script}\n")
    program.chmod(0o755)
    return str(program)


def plan(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Path], list[str]]:
    monkeypatch.setattr(quickstart.sys, "executable", command(folder, script))
    lines: list[str] = []
    pictures = quickstart.plan_and_draw(
        "http://127.0.0.1:1", folder / "out", os.environ, lines.append, TOURS["planar"].families
    )
    return pictures, lines


def test_a_problem_that_was_not_solved_is_an_outcome(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures, lines = plan(tmp_path, 'echo "not solved"; touch "$picture"; exit 1', monkeypatch)
    assert [picture.name for picture in pictures] == ["plan-uniform.png", "plan-narrow.png"]
    assert lines.count("not solved") == 2


@pytest.mark.parametrize("script", ["exit 1", 'touch "$picture"; exit 2'], ids=["crash", "refused"])
def test_a_planner_that_broke_is_an_error(
    script: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(PlanningError, match="the planner failed on the family uniform"):
        plan(tmp_path, script, monkeypatch)


def test_an_older_picture_does_not_hide_a_crash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan(tmp_path, 'touch "$picture"', monkeypatch)
    with pytest.raises(PlanningError):
        plan(tmp_path, "exit 1", monkeypatch)


def test_a_model_that_is_not_the_apis_default_is_named_with_its_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quickstart.sys, "executable", command(tmp_path, 'echo "$*" >&2; touch "$picture"'))
    monkeypatch.setattr(quickstart, "fetch_pictures", lambda *_: [])
    lines: list[str] = []
    training = TrainingResult(run_id="r1", model="panda-sampler", version=3, digest="d")
    evaluation = EvaluationResult(run_id="r2", version=3, promoted=True, reasons=(), metrics={})
    settings = Settings(home=tmp_path, root=tmp_path)
    progress = Progress(lines.append)
    quickstart._pictures(settings, TOURS["panda"], training, evaluation, progress)
    assert "--robot panda --model panda-sampler/3 --family uniform" in lines[1]
