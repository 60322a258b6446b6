import json

import pytest

from cspace.errors import JobError
from services.local.jobs import evaluation_result, training_result

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
    result = training_result(log(TRAINING))
    assert result.reference == "cspace-sampler/3"
    assert (result.run_id, result.digest, result.figures) == ("r1", "d1", ("vae-losses",))


def test_an_evaluation_result_holds_verdict_and_reasons() -> None:
    result = evaluation_result(log(EVALUATION))
    assert (result.promoted, result.reasons) == (True, ("beats uniform",))
    assert result.metrics == {"precision": 0.85}


def test_the_last_of_several_results_counts() -> None:
    text = log(TRAINING | {"version": 2}) + "more\n" + log(TRAINING)
    assert training_result(text).version == 3


def test_a_line_that_only_mentions_results_is_none() -> None:
    with pytest.raises(JobError, match="no result"):
        training_result("the RESULT {} comes later\nRESULTS {}\n")


@pytest.mark.parametrize("line", ["RESULT {", "RESULT []", "RESULT nothing"])
def test_a_result_that_is_no_object_is_an_error(line: str) -> None:
    with pytest.raises(JobError, match="the job's result"):
        training_result(line)


@pytest.mark.parametrize("name", ["run_id", "model", "version", "digest"])
def test_a_training_result_without_a_field_names_it(name: str) -> None:
    with pytest.raises(JobError, match=name):
        training_result(log({key: value for key, value in TRAINING.items() if key != name}))


@pytest.mark.parametrize("name", ["run_id", "version", "promoted", "reasons", "metrics"])
def test_an_evaluation_result_without_a_field_names_it(name: str) -> None:
    with pytest.raises(JobError, match=name):
        evaluation_result(log({key: value for key, value in EVALUATION.items() if key != name}))


def test_a_verdict_that_is_not_true_is_no_promotion() -> None:
    assert not evaluation_result(log(EVALUATION | {"promoted": "false"})).promoted
