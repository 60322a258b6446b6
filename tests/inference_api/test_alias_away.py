"""An alias whose registry is away: the answer tells so."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from inference_api.app import create_app
from inference_api.settings import ApiSettings
from services.names import MODEL_NAME
from tests.inference_api.answers import PNG
from tests.inference_api.client import ApiClient, running
from tests.inference_api.conftest import stock
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.tensor_client import IMAGES, json_input

CHALLENGER = f"{MODEL_NAME}@challenger"
NPY = {"accept": "application/x-npy"}


@pytest.fixture
def api(tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    # Nothing is trusted for longer than a question takes.
    settings = ApiSettings(cache_folder=tmp_path / "cache", poll_s=1e-6, pretrained_folder=bundles["shipped"])
    with running(create_app(settings, stock(registry, bundles))) as client:
        yield client


def ask(api: ApiClient, model: str, headers: dict[str, str] | None = None, **fields: str) -> httpx.Response:
    return api.post(
        "/sample", files={"image": PNG}, data={"n": "3", "model": model, **fields}, headers=headers
    )


def test_an_answer_by_an_alias_that_has_moved_while_the_registry_is_away_says_that_it_may_have(
    api: ApiClient, registry: CountingRegistry
) -> None:
    before = ask(api, CHALLENGER).json()["model"]
    assert (before["version"], before["alias_confirmed"]) == (2, True)
    registry.set_alias(MODEL_NAME, "challenger", 1)
    registry.away = True
    found = ask(api, CHALLENGER)
    assert found.status_code == 200
    assert (found.json()["model"]["version"], found.json()["model"]["alias_confirmed"]) == (2, False)
    headers = ask(api, CHALLENGER, NPY).headers
    assert (headers["x-model-version"], headers["x-alias-confirmed"]) == ("2", "false")


def test_an_alias_is_confirmed_again_when_the_registry_is_back(
    api: ApiClient, registry: CountingRegistry
) -> None:
    ask(api, CHALLENGER)
    registry.set_alias(MODEL_NAME, "challenger", 1)
    registry.away = True
    assert ask(api, CHALLENGER).json()["model"]["alias_confirmed"] is False
    registry.away = False
    again = ask(api, CHALLENGER).json()["model"]
    assert (again["version"], again["alias_confirmed"]) == (1, True)


def test_the_champion_is_unconfirmed_while_the_registry_is_away_and_a_version_is_what_it_is(
    api: ApiClient, registry: CountingRegistry
) -> None:
    def confirmed(model: str) -> bool:
        return bool(ask(api, model).json()["model"]["alias_confirmed"])

    champions, others = (MODEL_NAME, f"{MODEL_NAME}@champion"), (f"{MODEL_NAME}/2", "pretrained")
    assert [confirmed(model) for model in (*champions, *others)] == [True] * 4
    registry.away = True
    api.refresh()
    assert [confirmed(model) for model in (*champions, *others)] == [False, False, True, True]
    assert api.get("/health/ready").json()["model"]["alias_confirmed"] is False


def test_a_champion_that_could_not_follow_is_unconfirmed(
    api: ApiClient, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion", digest="1" * 64)
    api.refresh()
    assert ask(api, MODEL_NAME).json()["model"]["alias_confirmed"] is False


def test_the_open_inference_protocol_tells_it_as_well(api: ApiClient, registry: CountingRegistry) -> None:
    def confirmed() -> bool:
        body = {"inputs": [json_input(IMAGES[:1])], "parameters": {"n": 3}}
        answer = api.post(f"/v2/models/{CHALLENGER}/infer", json=body)
        return bool(answer.json()["parameters"]["alias_confirmed"])

    assert confirmed()
    registry.away = True
    assert not confirmed()
