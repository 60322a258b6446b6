"""The gate's decisions on recorded cases, and what single conditions say."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cspace.worlds import examples
from services.evaluator.evaluation import (
    QUICK,
    VALIDATION,
    Evaluation,
    Row,
    Setting,
    Unit,
    UnitResult,
    table_of,
)
from services.evaluator.gate import Bar, Champion, compare, decide
from services.evaluator.metrics import Task

HERE = Path(__file__).parent
RECORDED = json.loads((HERE / "gate_decisions.json").read_text())


@dataclass(frozen=True)
class Case:
    """Measured rows of a candidate and its rivals, and the metrics of champions that are not measured."""

    world: object
    path: bool
    ours: list
    rivals: dict
    recorded: list


def recorded_cases():
    rows = pd.read_parquet(HERE / "gate_cases.parquet").set_index(["case", "model"])
    for number, case in enumerate(RECORDED):
        models = {
            name: list(mine.itertuples(index=False, name=None))
            for name, mine in rows.loc[number].groupby(level="model", sort=False)
        }
        yield Case(examples()[case["world"]], case["path"], models.pop("m/1"), models, case["recorded"])


CASES = list(recorded_cases())


def evaluated(case):
    """The evaluation of a case."""

    def table(rows, model):
        unit = Unit(Task.RECONSTRUCTION, VALIDATION, 0, 1)
        return table_of([UnitResult(unit, [Row(*row) for row in rows], 0.0)], model)

    tables = [table(rows, name) for name, rows in {"m/1": case.ours, **case.rivals}.items()]
    return Evaluation(Setting(case.world, 0, QUICK, case.path), "m/1", pd.concat(tables), 0.0)


def judged(case, **changes):
    found = evaluated(case)
    compared = tuple(compare(found, rival) for rival in case.rivals)
    recorded = tuple(Champion(*one) for one in case.recorded)
    return decide(found, Bar(**{"comparisons": compared, "recorded": recorded, "against": 1, **changes}))


@pytest.mark.parametrize("number", range(len(RECORDED)))
def test_decisions_and_gains_are_those_that_were_recorded(number):
    verdict, recorded = judged(CASES[number]), RECORDED[number]
    assert verdict.promoted is recorded["promoted"], verdict.reasons
    gains = {
        one.rival: {
            gain.name: (gain.ours, gain.theirs, gain.gain.low, gain.gain.high, gain.gain.count)
            for gain in one.gains
        }
        for one in verdict.bar.comparisons
    }
    assert {rival: list(found) for rival, found in gains.items()} == {
        rival: list(found) for rival, found in recorded["gains"].items()
    }
    for rival, found in gains.items():
        np.testing.assert_allclose([*found.values()], [*recorded["gains"][rival].values()], atol=1e-6)


def reason(verdict, words):
    (found,) = (one for one in verdict.reasons if words in one)
    return found


def first(condition):
    return next(case for case, recorded in zip(CASES, RECORDED, strict=True) if condition(case, recorded))


@pytest.mark.parametrize(("change", "promoted"), [(0.02, True), (0.0201, False)])
def test_recorded_champions_may_be_better_by_the_margin_alone(change, promoted):
    case = first(lambda case, found: found["promoted"] and not case.path and not case.rivals)
    precision = evaluated(case).estimate("precision", "sampler", "uniform").estimate
    best, later = ({"precision": precision + one - 1e-12} for one in (change, 0.0))
    verdict = judged(case, recorded=(Champion(3, best), Champion(4, later)))
    assert verdict.promoted is promoted
    assert "of the" in reason(verdict, "recorded of version 3")


@pytest.mark.parametrize(("change", "promoted"), [(1.0, True), (-1.0, False)])
def test_a_champion_with_a_smaller_edr_is_better(change, promoted):
    case = first(lambda case, found: found["promoted"] and not case.path and not case.rivals)
    edr = evaluated(case).estimate("edr", "sampler", "uniform").estimate
    assert judged(case, recorded=(Champion(3, {"edr": edr + change}),)).promoted is promoted


def test_what_a_champion_has_and_the_version_was_not_measured_by_is_a_refusal():
    case = first(lambda case, found: found["promoted"] and not case.path and not case.rivals)
    case = replace(case, ours=[row for row in case.ours if row[0] != "planning"])
    verdict = judged(case, recorded=(Champion(3, {"planning_success": 0.5}),))
    assert not verdict.promoted
    assert "planning_success was not measured; version 3 has 0.500" in verdict.reasons


def test_where_too_few_samples_pass_a_head_the_run_without_it_counts_as_served():
    def fits(case, _):
        served = {row[0] for row in case.ours if row[4] == "confident"}
        return not case.path and len(case.rivals) > 0 and served == {"reconstruction", "planning"}

    case = first(fits)
    few = [row for row in case.ours if not (row[0] == "planning" and row[4] == "confident" and row[2] < 3)]
    success = {row[1:5]: row[7] for row in few if row[5] == "success"}
    drawn = {key[:3]: value for key, value in success.items() if key[3] == "learned"}
    served = drawn | {key[:3]: value for key, value in success.items() if key[3] == "confident"}
    found = compare(evaluated(replace(case, ours=few)), next(iter(case.rivals)))
    (gain,) = (one for one in found.gains if one.name == "planning success as served")
    assert gain.ours == pytest.approx(np.mean([*served.values()]))
