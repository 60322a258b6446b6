import json

import pytest

from cspace.errors import JobError
from services.local.jobs import EvaluationResult, TrainingResult, last_result

TRAINING = {
    "run_id": "r1",
    "model": "cspace-sampler",
    "version": 3,
    "digest": "d1",
    "data_digest": "d2",
    "metrics": {"critic_loss": 0.5},
    "figures": ["vae-losses"],
}
EVALUATION = {
    "run_id": "r2",
    "version": 3,
    "promoted": True,
    "reasons": ["beats uniform"],
    "metrics": {"precision": 0.85},
    "figures": ["gallery-test.png"],
}


def log(fields: object) -> str:
    return f"working\nRESULT {json.dumps(fields)}\n"


def test_a_training_result_names_its_version() -> None:
    result = last_result(log(TRAINING), TrainingResult)
    assert result.reference == "cspace-sampler/3"
    assert (result.run_id, result.digest, result.figures) == ("r1", "d1", ("vae-losses",))


def test_an_evaluation_result_holds_verdict_and_reasons() -> None:
    result = last_result(log(EVALUATION), EvaluationResult)
    assert (result.promoted, result.reasons) == (True, ("beats uniform",))
    assert result.metrics == {"precision": 0.85}


def test_the_last_of_several_results_counts() -> None:
    text = log(TRAINING | {"version": 2}) + "more\n" + log(TRAINING)
    assert last_result(text, TrainingResult).version == 3


def test_a_line_that_only_mentions_results_is_none() -> None:
    with pytest.raises(JobError, match="no result"):
        last_result("the RESULT {} comes later\nRESULTS {}\n", TrainingResult)


@pytest.mark.parametrize("line", ["RESULT {", "RESULT []", "RESULT nothing"])
def test_a_result_that_is_no_object_is_an_error(line: str) -> None:
    with pytest.raises(JobError, match="the job's result"):
        last_result(line, TrainingResult)


@pytest.mark.parametrize("name", ["run_id", "model", "version", "digest"])
def test_a_training_result_without_a_field_names_it(name: str) -> None:
    with pytest.raises(JobError, match=name):
        last_result(log({key: value for key, value in TRAINING.items() if key != name}), TrainingResult)


@pytest.mark.parametrize("name", ["run_id", "version", "promoted", "reasons", "metrics"])
def test_an_evaluation_result_without_a_field_names_it(name: str) -> None:
    with pytest.raises(JobError, match=name):
        last_result(log({key: value for key, value in EVALUATION.items() if key != name}), EvaluationResult)


def test_a_verdict_that_is_no_truth_value_is_an_error() -> None:
    with pytest.raises(JobError, match="promoted"):
        last_result(log(EVALUATION | {"promoted": "false"}), EvaluationResult)
