"""The commands with a real MLflow: the shipped model imported and judged, a worsened copy of it refused."""

import json

import pytest

from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator import __main__ as evaluator
from services.evaluator import evaluation
from services.evaluator.evaluation import Budget
from services.names import ALIAS_CHAMPION, MODEL_NAME
from services.registry import __main__ as models
from services.registry.models import ModelRegistry
from services.registry.promotion import decisions
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.worsened import copy_of_shipped

pytestmark = [pytest.mark.slow, pytest.mark.e2e, pytest.mark.timeout(600), *MLFLOW_WARNINGS]

SMALL = Budget(20, 500, 3, 1, 1, 0, 1, narrow_scenarios=1)


def test_the_imported_shipped_model_is_judged_and_a_worsened_copy_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(evaluation.BUDGETS, "quick", SMALL)
    (tmp_path / "mlflow").mkdir()
    with mlflow_server(tmp_path / "mlflow") as uri:
        environment = {"MLFLOW_TRACKING_URI": uri}

        def evaluate(folder, number):
            assert models.main(["models", "import", str(folder), MODEL_NAME], environment) == 0
            assert evaluator.main(["--model", f"{MODEL_NAME}/{number}"], environment) == 0
            printed = capsys.readouterr().out
            assert "evaluated on scenes of the planar world with 3 discs" in printed
            return json.loads(printed.splitlines()[-1].removeprefix("RESULT "))

        first = evaluate(PRETRAINED_FOLDER, 1)
        assert first["promoted"], first["reasons"]
        unfiltered = copy_of_shipped(tmp_path / "unfiltered", confidence_threshold=0.0)
        noisy = copy_of_shipped(tmp_path / "noisy", noise=0.1)
        for number, bundle in ((2, unfiltered), (3, noisy)):
            result = evaluate(bundle.folder, number)
            assert not result["promoted"]
            (worse,) = [reason for reason in result["reasons"] if reason.startswith("worse than version 1")]
            assert "precision" in worse
        registry = ModelRegistry(uri)
        assert registry.by_alias(MODEL_NAME, ALIAS_CHAMPION).number == 1
        assert [(one.version, one.promoted, one.against) for one in decisions(registry, MODEL_NAME)] == [
            (1, True, None),
            (2, False, 1),
            (3, False, 1),
        ]
