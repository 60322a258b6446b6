"""The paper's comparison on tiny bundles: what it asks of the jobs, its table, its pictures."""

import json
from functools import partial
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from benchmarks.paper import jobs
from benchmarks.paper.columns import COLUMNS, CONTROLS, Scale
from benchmarks.paper.figures import convergence, reconstruction, typical
from benchmarks.paper.jobs import Study, train_columns
from benchmarks.paper.measures import Effort, final_quality, learning_curve, table
from cspace.bundle import Bundle
from cspace.errors import JobError
from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.scenes import Scene, Stage
from services.planner.samples import BundleSampler
from tests.bundles import write_tiny_bundle
from tests.training.models.builders import tiny_module
from training.models.checkpoint import Progress, save_checkpoint

JOINT, SINGLE, MEANS, CLUSTERS = COLUMNS
EFFORT = Effort(scenarios=2, validation=2, topology=1, draws=2, samples=80, topology_samples=80)


@pytest.fixture
def study(tmp_path):
    return Study(tmp_path, Scale(share=0.01, hidden=8, snapshots=3))


@pytest.fixture
def bundle(tmp_path):
    return Bundle.load(write_tiny_bundle(tmp_path / "bundle"))


def begun(study, column, *lines, trial="global", steps=()):
    """The traces of a column's job: its log, its record, checkpoints of one trial."""
    study.log(column).parent.mkdir(parents=True, exist_ok=True)
    study.log(column).write_text("\n".join(["run: abc", *lines]) + "\n", encoding="utf-8")
    folder = study.data / "jobs" / "abc"
    for step in steps:
        history = ({"step": float(step), "wasserstein_estimate": 1.0, "generator_loss": 0.5},)
        place = folder / "stage" / trial / f"step-{step:09d}"
        save_checkpoint(place, tiny_module(), Progress(step, "run", history))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "job.json").write_text("{}")


@pytest.mark.parametrize("column", [*COLUMNS, *CONTROLS], ids=lambda column: column.name)
def test_every_column_is_a_valid_job_with_the_same_share_and_width(column):
    config = Scale(share=0.1, hidden=16).config(column, None)
    assert (config.global_.steps, config.local.steps, config.vae.steps) == (15_630, 7_820, 600)
    assert {config.global_.hidden, config.global_.critic_hidden, config.local.hidden} == {16}
    assert config.data == Scale().config(SINGLE, None).data


def test_the_snapshots_are_spread_over_all_steps_and_all_kept():
    config = Scale(share=0.1, snapshots=6).config(MEANS, None)
    assert config.resources.checkpoint_every_steps == 2605
    assert config.resources.checkpoints_kept >= 6


def test_the_whole_budget_is_the_presets():
    whole = Scale(share=1.0, hidden=512).config(CLUSTERS, None)
    assert (whole.global_.steps, whole.local_trials, whole.local.steps) == (156_300, 2, 78_200)
    assert whole.global_.hidden == 512


def test_a_shared_encoder_is_an_existing_checkpoint_and_the_joint_column_takes_none(study, tmp_path):
    assert study.scale.config(MEANS, tmp_path).vae.checkpoint == tmp_path
    assert study.scale.config(JOINT, None).joint


def test_a_column_has_a_result_once_its_job_has_printed_one(study):
    assert study.result(SINGLE) is None
    begun(study, SINGLE, "RESULT " + json.dumps({"version": 1}), "RESULT " + json.dumps({"version": 2}))
    assert study.result(SINGLE) == {"version": 2}


def test_the_encoder_is_there_only_when_it_is_trained_to_its_end(study):
    begun(study, SINGLE, trial="vae", steps=(30,))
    assert study.encoder() is None
    begun(study, SINGLE, trial="vae", steps=(30, 60))
    assert study.encoder() == study.checkpoints(SINGLE, "vae")[60]


class Job:
    """A job's process that ends at once; ``printed`` is what it leaves in its log."""

    started: ClassVar[list["Job"]] = []

    def __init__(self, command, stdout, printed, **options):
        self.command, self.options = command, options
        stdout.write(printed)
        Job.started.append(self)

    def wait(self):
        return 0

    def terminate(self):
        pass


def run_jobs(monkeypatch, study, columns, printed):
    """What train_columns starts where every job prints this."""
    monkeypatch.setattr(Job, "started", [])
    monkeypatch.setattr(jobs.subprocess, "Popen", partial(Job, printed=printed))
    here = SimpleNamespace(gcs_address="here:1")
    cluster = SimpleNamespace(init=dict, shutdown=dict, get_runtime_context=lambda: here)
    monkeypatch.setattr(jobs, "ray", cluster)
    train_columns(study, columns, say=str)
    return Job.started


def test_columns_are_trained_in_turn_inside_the_studys_folder(study, monkeypatch):
    begun(study, SINGLE, "RESULT {}", trial="vae", steps=(60,))
    started = run_jobs(monkeypatch, study, [JOINT, SINGLE, MEANS], b"RESULT {}\n")
    assert [job.command[job.command.index("--preset") + 1] for job in started] == [
        "paper_joint",
        "paper_means",
    ]
    assert [f"vae.checkpoint={study.encoder()}" in job.command for job in started] == [False, True]
    assert started[0].options["cwd"] == study.out
    assert started[0].options["env"]["CSPACE_DATA_DIR"] == str(study.data)
    assert started[0].options["env"]["RAY_ADDRESS"] == "here:1"


def test_a_job_without_a_result_ends_the_study_and_is_resumed_by_the_next(study, monkeypatch):
    begun(study, JOINT)
    with pytest.raises(JobError, match="the column joint failed"):
        run_jobs(monkeypatch, study, [JOINT, SINGLE], b"no result\n")
    assert [job.command[2:] for job in Job.started] == [["--resume", "abc"]]


def test_the_table_has_every_column_seen_and_unseen_and_measures_nothing_twice(study, bundle, monkeypatch):
    found = {SINGLE.name: final_quality(study, SINGLE, bundle, 0, EFFORT)}
    rows = table([SINGLE], found)
    assert [row[:2] for row in rows[1:]] == [
        [SINGLE.label, "seen"],
        ["uniform", "seen"],
        ["real", "seen"],
        [SINGLE.label, "unseen"],
        ["uniform", "unseen"],
        ["real", "unseen"],
    ]
    assert rows[3][2].startswith("1.000")
    monkeypatch.setattr("benchmarks.paper.measures.reconstruct", None)
    assert final_quality(study, SINGLE, bundle, 0, EFFORT) == found[SINGLE.name]


def test_another_bundle_is_measured_anew(study, bundle, tmp_path):
    other = Bundle.load(write_tiny_bundle(tmp_path / "other", scale=0.1))
    first, second = (final_quality(study, SINGLE, one, 0, EFFORT) for one in (bundle, other))
    assert first["seen"]["sampler"] != second["seen"]["sampler"]
    assert first["seen"]["uniform"] == second["seen"]["uniform"]


def test_the_learning_curve_has_losses_and_a_row_a_snapshot(study, bundle):
    begun(study, SINGLE, steps=(10, 20))
    curve = learning_curve(study, SINGLE, {10: bundle, 20: bundle}, EFFORT)
    assert [row["step"] for row in curve["quality"]] == [10, 20]
    assert curve["losses"][-1]["step"] == 20.0
    assert set(curve["quality"][0]["edr"]) >= {"low", "estimate", "high"}


def test_the_convergence_draws_a_line_a_column(study, bundle):
    begun(study, SINGLE, steps=(10, 20))
    curve = learning_curve(study, SINGLE, {10: bundle, 20: bundle}, EFFORT)
    figure = convergence({"one": curve, "two": curve}, {"precision": 0.7, "coverage": 0.9, "edr": 1.0})
    panels = {axes.get_title(): axes for axes in figure.axes}
    precision = next(axes for title, axes in panels.items() if title.startswith("precision"))
    assert len(precision.lines) == 3
    assert list(precision.lines[0].get_xdata()) == [10, 20]


def test_the_reconstruction_marks_as_many_mistakes_as_there_are(bundle):
    scene = typical(Stage(PlanarWorld(TWO_LINK, Camera()), Split.DEMO, 0), among=3)
    figure = reconstruction([scene], {"one": BundleSampler(bundle)}, draws=2)
    drawn = np.asarray(bundle.sample(scene.image, 1000, scene.sampler_seed()).samples, dtype=np.float64)
    wrong = int((~scene.checker.valid_batch(drawn)).sum())
    clouds = [axes for axes in figure.axes if "GS-C" in axes.get_xlabel()]
    assert [len(one.get_offsets()) for one in clouds[1].collections] == [1000 - wrong, wrong]
    assert [len(one.get_offsets()) for one in clouds[0].collections] == [1000, 0]
    assert f"{1 - wrong / 1000:.1%} free" in clouds[1].get_xlabel()


def test_the_typical_scenario_is_the_median_by_free_share():
    stage = Stage(PlanarWorld(TWO_LINK, Camera()), Split.DEMO, 0)
    grid = np.stack(np.meshgrid(*[np.linspace(-np.pi, np.pi, 120)] * 2), axis=-1).reshape(-1, 2)
    shares = [Scene(stage, index).checker.valid_batch(grid).mean() for index in range(5)]
    # Far enough from its neighbours that a thousand draws tell it from them.
    assert np.diff(np.sort(shares)[1:4]).min() > 0.1
    assert typical(stage, among=5).index == np.argsort(shares)[2]
