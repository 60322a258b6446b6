"""The main job's parts: jobs by Ray's command, the wait for the API, the planner's outcomes."""

import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest

from cspace.errors import JobError, PlanningError, ServiceError
from services.local.quickstart import plan_and_draw, run_job, wait_served
from services.local.stack import Settings
from tests.services.local.conftest import WriteStub, ignore

RESULT = {"run_id": "r2", "model": "cspace-sampler", "version": 3, "promoted": True, "reasons": ["better"]}


def test_a_job_is_submitted_and_shown_without_colours_and_its_last_result_counts(
    settings: Settings, write_stub: WriteStub
) -> None:
    lines = [
        "\x1b[36mstep 1\x1b[0m",
        f"RESULT {json.dumps(RESULT | {'version': 2})}",
        f"RESULT {json.dumps(RESULT)}",
    ]
    text = "\n".join(lines)
    write_stub("ray", f"#!/bin/sh\necho asked: $@ at $RAY_ADDRESS\ncat <<'END'\n{text}\nEND\n")
    shown: list[str] = []
    found = run_job(settings, "python train.py --set 'a=b c'", shown.append)
    assert (found.reference, found.promoted, found.reasons) == ("cspace-sampler/3", True, ("better",))
    asked = f"  asked: job submit --log-color=false -- python train.py --set a=b c at {settings.url('ray')}"
    assert shown[1:] == [asked, "  step 1"]


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("echo why; exit 1", "failed"),
        ("echo RESULTS {}", "left no result"),
        ("echo 'RESULT {}'", "left no result"),
    ],
)
def test_a_job_that_fails_or_leaves_no_result_is_an_error(
    settings: Settings, write_stub: WriteStub, program: str, words: str
) -> None:
    write_stub("ray", f"#!/bin/sh\n{program}\n")
    with pytest.raises(JobError, match=words):
        run_job(settings, "python train.py", ignore)


ONE = {"reference": "cspace-sampler/1", "default": True}
TWO = {"reference": "cspace-sampler/2", "default": False}
PROMOTED = [ONE | {"default": False}, TWO | {"default": True}]
BROKEN = [httpx.Response(503), httpx.Response(200, text="<html>"), httpx.Response(200, json=[1])]


@pytest.mark.parametrize(
    ("answers", "default", "pauses"),
    [([[ONE, TWO]], False, 0), ([[ONE], [ONE, TWO], PROMOTED], True, 2), ([*BROKEN, [TWO]], False, 3)],
    ids=["listed", "promoted", "after errors"],
)
def test_the_api_is_asked_until_it_serves_the_version(
    monkeypatch: pytest.MonkeyPatch, answers: list[object], default: bool, pauses: int
) -> None:
    left, paused = list(answers), []

    def get(url: str, **_: object) -> httpx.Response:
        answer = left.pop(0) if len(left) > 1 else left[0]
        found = answer if isinstance(answer, httpx.Response) else httpx.Response(200, json={"models": answer})
        found.request = httpx.Request("GET", url)
        return found

    monkeypatch.setattr(httpx, "get", get)
    own = SimpleNamespace(**vars(time) | {"sleep": paused.append})
    monkeypatch.setattr("services.local.quickstart.time", own)
    wait_served("http://api", "cspace-sampler/2", default=default)
    assert len(paused) == pauses
    with pytest.raises(ServiceError, match="cspace-sampler/9"):
        wait_served("http://api", "cspace-sampler/9", default=False, limit_s=0.0)


@pytest.mark.parametrize(
    ("script", "works"),
    [
        ('touch "$picture"', True),
        ('touch "$picture"; exit 1', True),
        ("exit 1", False),
        ('touch "$picture"; exit 2', False),
    ],
    ids=["solved", "not solved", "crashed", "refused"],
)
def test_a_problem_that_was_not_solved_is_an_outcome_and_a_broken_planner_an_error(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, works: bool
) -> None:
    program, folder = tmp_path / "planner", tmp_path / "out"
    program.write_text(f"#!/bin/sh\nfor picture; do :; done\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    folder.mkdir()
    # An older picture does not hide a crash.
    (folder / "plan-uniform.png").touch()
    if works:
        assert plan_and_draw(settings, folder, ignore, ["uniform"]) == [folder / "plan-uniform.png"]
    else:
        with pytest.raises(PlanningError, match="the family uniform"):
            plan_and_draw(settings, folder, ignore, ["uniform"])
