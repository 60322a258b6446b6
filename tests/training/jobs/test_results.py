"""What a job says at its end."""

import json

from services.commands import RESULT_FILE, report_result
from services.local.quickstart import last_result
from training.jobs.job import JobResult

RESULT = JobResult("r1", "arm", 3, "d1", "d2", {"loss": 0.12345678}, {"vae": (10.0, 14.5)}, ("vae-losses",))


def output_of(folder):
    """Tell a result whose folder is not there yet."""
    content = {"run_id": "r1", "model": "arm", "version": 3, "digest": "d1", "figures": []}
    report_result(content, RESULT.rows(folder), folder)
    return content


def test_the_block_tells_version_and_where_bundle_and_json_lie(tmp_path, capsys):
    folder = tmp_path / "jobs" / "r1"
    content = output_of(folder)
    log = capsys.readouterr().out
    for part in ("arm/3", "vae 4.5 s", "loss 0.1235", str(folder / "bundle"), str(folder / RESULT_FILE)):
        assert part in log
    assert json.loads((folder / RESULT_FILE).read_text()) == content
    # The last line is for programs.
    assert log.splitlines()[-1].startswith("RESULT {")
    assert last_result(log.splitlines()).reference == "arm/3"


def test_a_job_without_a_folder_keeps_no_file_and_a_full_disk_costs_the_file_alone(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    report_result({"run_id": "r1"}, {"run": "r1"}, None)
    *block, last = capsys.readouterr().out.splitlines()
    assert block == ["", "result", "  run  r1"]
    assert last == 'RESULT {"run_id": "r1"}'
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "full").write_text("no folder can be made here")
    report_result({"run_id": "r1"}, {"run": "r1"}, tmp_path / "full")
    printed = capsys.readouterr().out
    assert "not kept" in printed
    assert printed.splitlines()[-1] == last
