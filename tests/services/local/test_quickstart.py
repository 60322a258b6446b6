"""The main job's parts: jobs by Ray's command, the wait for the API, the planner's outcomes."""

import json
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from cspace.errors import JobError, PlanningError, ServiceError
from cspace.worlds.spatial.world import shipped
from services.local.quickstart import plan_and_draw, run_job, serve_untrained, wait_served
from services.local.stack import Settings
from tests.services.local.conftest import STUB, WriteStub, ignore

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
BROKEN = [(503, ""), (200, "<html>"), (200, "[1]")]


def listed(*models: dict[str, object]) -> tuple[int, str]:
    return 200, json.dumps({"models": models})


@pytest.mark.parametrize(
    ("answers", "default"),
    [
        ([listed(ONE, TWO)], False),
        ([listed(ONE), listed(ONE, TWO), listed(*PROMOTED)], True),
        ([*BROKEN, listed(TWO)], False),
    ],
    ids=["listed", "promoted", "after errors"],
)
def test_the_api_is_asked_until_it_serves_the_version(answers: list[tuple[int, str]], default: bool) -> None:
    left = list(answers)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, text = left.pop(0)
            self.send_response(status)
            self.end_headers()
            self.wfile.write(text.encode())

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        wait_served(f"http://127.0.0.1:{server.server_port}", "cspace-sampler/2", default=default)
        server.shutdown()
    assert left == []
    with pytest.raises(ServiceError, match="cspace-sampler/9"):
        wait_served("http://127.0.0.1:1", "cspace-sampler/9", default=False, limit_s=0.5)


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
    settings: Settings, write_stub: WriteStub, tmp_path: Path, script: str, works: bool
) -> None:
    write_stub("python", f"#!/bin/sh\nfor picture; do :; done\n{script}\n")
    # An older picture does not hide a crash.
    (folder := tmp_path / "out").mkdir()
    (folder / "plan-uniform.png").touch()
    if works:
        assert plan_and_draw(settings, folder, ignore, ["uniform"]) == [folder / "plan-uniform.png"]
    else:
        with pytest.raises(PlanningError, match="the family uniform"):
            plan_and_draw(settings, folder, ignore, ["uniform"])


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(replace(shipped("ur5"), name="Bench_Arm 5").to_dict()))
    return path


@pytest.mark.usefixtures("programs")
@pytest.mark.parametrize("reachable", [True, False], ids=["a plan", "no problem"])
def test_an_arm_without_training_is_registered_served_and_planned_with_where_there_is_a_problem(
    settings: Settings, arm: Path, monkeypatch: pytest.MonkeyPatch, reachable: bool
) -> None:
    if not reachable:
        monkeypatch.setattr("cspace.worlds.spatial.problems.MAX_DRAWS", 0)
    lines: list[str] = []
    serve_untrained(settings, arm, lines.append)
    said = "\n".join(lines)
    assert f"-m training.untrained {arm} " in said
    assert "waiting until the inference API serves bench-arm-5-sampler/1" in said
    assert (f"--robot {arm} --whole-plan --family table" in said) == reachable
    assert ("no plan to show: no problem" in said) != reachable
    assert "model=bench-arm-5-sampler" in said


@pytest.mark.usefixtures("programs")
def test_a_model_that_was_not_made_ends_it(settings: Settings, arm: Path, write_stub: WriteStub) -> None:
    write_stub(
        "python",
        STUB.replace(
            'if "training.untrained"', 'if "training.untrained" in sys.argv:\n    sys.exit(1)\nif "never"'
        ),
    )
    with pytest.raises(JobError, match="was not made"):
        serve_untrained(settings, arm, ignore)
