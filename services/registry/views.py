"""The experiment's page in MLflow's UI: its kind, its description, and saved searches of runs."""

import json
from collections.abc import Mapping

from services.names import MLFLOW_TRAINING, NOTE, TAG_JOB, TAG_MODEL, TAG_PRESET, TAG_STAGE

# What the UI keeps of a search when somebody presses Share: a tag of the experiment, opened by
# ``viewStateShareKey`` in the address.
VIEW = "mlflow.sharedViewState."
_QUALITY = ("precision", "served_precision", "coverage", "served_coverage", "edr", "planning_success")
# What each shows, which runs, and the columns.
VIEWS: dict[str, tuple[str, str, list[str]]] = {
    "jobs": (
        "every training job with its settings and the figures of its last evaluation",
        f"tags.{TAG_STAGE} LIKE '%-train'",
        [f"tags.`{TAG_MODEL}`", *(f"params.`{name}`" for name in ("seed", "clusters.form", "local.steps"))]
        + [f"metrics.`validation/{name}`" for name in _QUALITY],
    ),
    "trials": (
        "the local trials of all jobs, with the parameters and last losses of each",
        f"tags.{TAG_STAGE} = 'local'",
        [f"tags.`{TAG_JOB}`", f"tags.`{TAG_PRESET}`"]
        + [f"params.`{name}`" for name in ("cluster", "share_of_data", "steps", "seed", "parameters")]
        + ["metrics.`critic_loss`", "metrics.`wasserstein_estimate`"]
        + ["metrics.`generator_loss`", "metrics.`steps_per_s`"],
    ),
    "evaluations": (
        "every evaluation of a registered version, validation and test",
        f"tags.{TAG_STAGE} = 'evaluation'",
        [f"tags.`{TAG_MODEL}`", "tags.`promoted`", "params.`seed`", "params.`scenarios`"]
        + [f"metrics.`{split}/{name}`" for split in ("validation", "test") for name in _QUALITY[:5]],
    ),
    "planning": (
        "the planning benchmarks",
        f"tags.{TAG_STAGE} = 'planning-benchmark'",
        ["tags.`protocol`", "params.`setting.seed`"],
    ),
}


def experiment_page(experiment_id: str) -> Mapping[str, str]:
    """The experiment's tags: kind, description, views."""
    place = f"#/experiments/{experiment_id}/runs?{MLFLOW_TRAINING}&viewStateShareKey="
    lines = [f"- [{name}]({place}{name}): {words}; `{search}`" for name, (words, search, _) in VIEWS.items()]
    note = (
        "Learned samplers for motion planning. A training job is a run with a child for each of its trials; "
        "an evaluation is a child of the job whose version it evaluates, and leaves its headline on the job, "
        "on the version and on its logged model.\n\nSaved views of the runs:\n\n" + "\n".join(lines) + "\n\n"
        "Choose runs and press Compare for parameters and metrics side by side; the image grid of the chart "
        "view sets galleries beside each other, the evaluation view tables. Models compares versions."
    )
    tags = {"mlflow.experimentKind": "custom_model_development", NOTE: note}
    for name, (_, search, columns) in VIEWS.items():
        shown = ["attributes.`Created`", *columns]
        order = {"orderByKey": shown[0], "orderByAsc": False}
        tags[f"{VIEW}{name}"] = json.dumps({"searchFilter": search, **order, "selectedColumns": shown})
    return tags
