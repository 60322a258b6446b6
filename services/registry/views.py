"""The experiment's page in MLflow's UI: its kind, its description, and saved searches of runs."""

import json
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from services.names import MLFLOW_TRAINING, NOTE, TAG_JOB, TAG_MODEL, TAG_PRESET, TAG_STAGE

# What the UI keeps of a search when somebody presses Share: a tag of the experiment, opened by
# ``viewStateShareKey`` in the address.
VIEW = "mlflow.sharedViewState."
_QUALITY = ("precision", "served_precision", "coverage", "served_coverage", "edr", "planning_success")


class View(NamedTuple):
    """A saved search of runs: what it shows, which runs, and the columns by kind."""

    words: str
    search: str
    columns: Mapping[str, Sequence[str]]

    def state(self) -> str:
        """The state of the UI, as its tag holds it."""
        columns = {"attributes": ["Created"], **self.columns}
        return json.dumps(
            {
                "searchFilter": self.search,
                "orderByKey": "attributes.`Created`",
                "orderByAsc": False,
                "selectedColumns": [f"{kind}.`{name}`" for kind, names in columns.items() for name in names],
            }
        )


VIEWS = {
    "jobs": View(
        "every training job with its settings and the figures of its last evaluation",
        f"tags.{TAG_STAGE} LIKE '%-train'",
        {
            "tags": [TAG_MODEL],
            "params": ["seed", "clusters.form", "local.steps"],
            "metrics": [f"validation/{name}" for name in _QUALITY],
        },
    ),
    "trials": View(
        "the local trials of all jobs, with the parameters and last losses of each",
        f"tags.{TAG_STAGE} = 'local'",
        {
            "tags": [TAG_JOB, TAG_PRESET],
            "params": ["cluster", "share_of_data", "steps", "seed", "parameters"],
            "metrics": ["critic_loss", "wasserstein_estimate", "generator_loss", "steps_per_s"],
        },
    ),
    "evaluations": View(
        "every evaluation of a registered version, validation and test",
        f"tags.{TAG_STAGE} = 'evaluation'",
        {
            "tags": [TAG_MODEL, "promoted"],
            "params": ["seed", "scenarios"],
            "metrics": [f"{split}/{name}" for split in ("validation", "test") for name in _QUALITY[:5]],
        },
    ),
    "planning": View(
        "the planning benchmarks",
        f"tags.{TAG_STAGE} = 'planning-benchmark'",
        {"tags": ["protocol"], "params": ["setting.seed"]},
    ),
}


def experiment_page(experiment_id: str) -> Mapping[str, str]:
    """The experiment's tags: kind, description, views."""
    place = f"#/experiments/{experiment_id}/runs?{MLFLOW_TRAINING}&viewStateShareKey="
    lines = "\n".join(
        f"- [{name}]({place}{name}): {view.words}; `{view.search}`" for name, view in VIEWS.items()
    )
    note = (
        "Learned samplers for motion planning. A training job is a run with a child for each of its trials; "
        "an evaluation is a child of the job whose version it evaluates, and leaves its headline on the job, on "
        "the version and on its logged model.\n\n"
        f"Saved views of the runs:\n\n{lines}\n\n"
        "Choose runs and press Compare for parameters and metrics side by side; the image grid of the chart "
        "view sets galleries beside each other, the evaluation view tables. Models compares versions."
    )
    kind = {"mlflow.experimentKind": "custom_model_development", NOTE: note}
    return kind | {f"{VIEW}{name}": view.state() for name, view in VIEWS.items()}
