"""What requests can name, and of which robot each model is."""

from functools import lru_cache
from typing import Any

from cspace.errors import InputError, ScenarioError
from cspace.query import is_digest
from cspace.strict_json import parse_json
from cspace.world import World
from cspace.worlds import read_world, robot_digest
from inference_api.models.served import PRETRAINED_VERSION
from inference_api.models.store import ModelStore
from inference_api.pages.model_schemas import ListedModel, ModelList, joint_space_info
from services.names import MAX_WORLD, TAG_ROBOT, TAG_WORLD
from services.registry.models.port import ModelVersion
from services.registry.references import is_model_name


def listed(store: ModelStore, name: str | None) -> ModelList:
    """Versions of a model, None for the default one, newest first, and the shipped models.

    Raises:
        InputError: the name is none.
    """
    if name is not None and not is_model_name(name):
        raise InputError("name is wrong", expected="a registered model's name", got=repr(name)[:200])
    served = store.default
    default = None if served is None else (served.name, served.version)
    models = [
        ListedModel(
            reference=str(version),
            name=version.name,
            version=version.number,
            aliases=list(version.aliases),
            run_id=version.run_id or None,
            digest=version.digest,
            loaded=(bundle := store.loaded(version)) is not None,
            default=(version.name, version.number) == default,
            **_described(
                _told(version) if bundle is None else bundle.spec.world, version.tags.get(TAG_ROBOT)
            ),
        )
        for version in store.versions(name or store.model_name)
    ]
    models += [
        ListedModel(
            reference=shipped.name,
            name=shipped.name,
            version=PRETRAINED_VERSION,
            aliases=[],
            run_id=None,
            digest=shipped.digest,
            loaded=shipped.loaded is not None,
            default=default == (shipped.name, PRETRAINED_VERSION),
            **_described(shipped.spec.world),
        )
        for shipped in store.shipped
    ]
    return ModelList(default=store.model_name, registry=store.registry_state, models=models)


def _told(version: ModelVersion) -> World | None:
    return _read(version.tags.get(TAG_WORLD, ""))


def _described(world: World | None, robot: str | None = None) -> dict[str, Any]:
    if world is None:
        return {"robot": robot if robot and is_digest(robot) else None, "world": None, "joint_space": None}
    space = joint_space_info(world.space.to_dict())
    return {"robot": robot_digest(world), "world": world.to_dict(), "joint_space": space}


@lru_cache(maxsize=1024)
def _read(tag: str) -> World | None:
    """What registration wrote of a version's world, or somebody else, who may write what he likes."""
    try:
        return read_world(parse_json(tag.encode())) if 0 < len(tag) <= MAX_WORLD else None
    except (ScenarioError, ValueError, RecursionError):
        return None
