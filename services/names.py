"""The names under which runs and models are found; models have those of their robots."""

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from cspace.errors import ConfigError
from cspace.world import World
from cspace.worlds import KINDS, default_world, examples, robot_digest

MODEL_NAME = "cspace-sampler"
PATH_MODEL_NAME = "path-sampler"
EXPERIMENT = "cspace-sampler"
# Of what users report of answers.
OUTCOMES_EXPERIMENT, OUTCOMES_FILE = "cspace-outcomes", "outcomes.parquet"
# The plans of these that were asked to be kept with their pictures, the kind of their rows, and on a run when
# they have to be gone, s since 1970.
VIEWS_FILE, VIEW, TAG_KEEP_UNTIL = "views.jsonl", "view", "keep_until_s"
# A registered model that is no sampler: earlier code kept versions of the scene model.
SCENE_MODEL_NAME = "scene-model"
# The setting that names where artifacts lie that the tracking server does not hand out itself: ``s3://models``.
ARTIFACT_STORE = "CSPACE_ARTIFACT_STORE"
# The variable that ``python -m services.local env`` sets in a shell: the API that commands ask.
API_URL = "CSPACE_API_URL"
ALIAS_CHALLENGER = "challenger"
ALIAS_CHAMPION = "champion"

TAG_DIGEST = "digest"
# On a run: what it is of, the job's name, its preset, the version made or evaluated, and MLflow's note.
TAG_STAGE, TAG_JOB, TAG_PRESET, TAG_MODEL = "stage", "job", "preset", "model_version"
NOTE = "mlflow.note.content"
TAG_PARENT = "mlflow.parentRunId"
# In an address of MLflow's pages: without it they are those for language models.
MLFLOW_TRAINING = "workflowType=machine_learning"
# On a run: what :meth:`services.registry.tracking.Tracking.start` finds it by.
TAG_KEY = "cspace.key"
# On a version: the signature of its bundle, see :mod:`services.registry.signing`.
TAG_SIGNATURE = "signature"
# On a version: when it was the champion and was rolled back from, ISO 8601 in UTC.
TAG_ROLLED_BACK = "rolled_back"
# On a version: SHA-256 of its robot, and its world as JSON where that is no longer than this.
TAG_ROBOT, TAG_WORLD = "robot", "world"
MAX_WORLD = 4000

_SUFFIX, _PATH_SUFFIX = "-sampler", "-path-sampler"
ROBOT_NAME = r"[A-Za-z0-9][A-Za-z0-9-]{0,62}"
_DERIVED = rf"({'|'.join(KINDS)})-[0-9a-f]{{8}}"


def robot_name(world: World, given: str | None = None) -> str:
    """A robot's name: the example's, else the given one, else one that is derived from its digest."""
    digest = robot_digest(world)
    example = next((name for name, one in examples().items() if robot_digest(one) == digest), None)
    derived = f"{world.kind}-{digest[:8]}"
    own = example or derived
    if given is None or given == own:
        return own
    if re.fullmatch(ROBOT_NAME, given, re.ASCII) is None:
        raise ConfigError(
            "robot_name does not fit", expected="1 to 63 letters, digits and -, no - first", got=repr(given)
        )
    # Some would make a name of a model that is another robot's.
    if example or given.endswith("-path") or is_kept(f"{given}{_SUFFIX}"):
        raise ConfigError(
            "robot_name is another robot's",
            expected=own if example else f"{own}, or a name that no other robot has",
            got=repr(given),
            remedy="leave robot_name out, or set it to another name",
        )
    return given


def label(world: World) -> str | None:
    """What a description calls a robot that is no example, as a name of models; None where it cannot be."""
    text = re.sub(r"[^a-z0-9]+", "-", str(getattr(world.body, "name", "")).lower()).strip("-")
    with suppress(ConfigError):
        named = robot_name(world, text)
        return None if named == robot_name(world) else named
    return None


def shown_name(world: World, given: str | None) -> str:
    """A robot's name for people: the given one, or its own where the given one is another's by now."""
    with suppress(ConfigError):
        return robot_name(world, given)
    return robot_name(world)


def model_name(world: World, given: str | None = None, *, path: bool = False) -> str:
    """The registered model of a robot, of configurations or of paths; ``given`` as in :func:`robot_name`."""
    name = robot_name(world, given)
    if robot_digest(world) == robot_digest(default_world()):
        return PATH_MODEL_NAME if path else MODEL_NAME
    return f"{name}{_PATH_SUFFIX if path else _SUFFIX}"


def model_of(robot: str) -> str:
    """The registered model of a robot's name."""
    return MODEL_NAME if robot == robot_name(default_world()) else f"{robot}{_SUFFIX}"


def is_own(model: str, world: World) -> bool:
    """Whether a model's name is one that its robot has without being given it."""
    return model in {model_name(world), model_name(world, path=True)} or _robot_of(model) == robot_name(world)


def is_kept(model: str) -> bool:
    """Whether a model's name is an example's, or one that is derived from a robot's digest."""
    robot = _robot_of(model) or ""
    derived = re.fullmatch(_DERIVED, robot, re.ASCII) is not None
    return derived or robot in examples() or model in (MODEL_NAME, PATH_MODEL_NAME)


def world_tags(world: World) -> dict[str, str]:
    """What a version's tags tell of its world: the robot's digest, and all of it where it is short."""
    text = json.dumps(world.to_dict(), sort_keys=True)
    return {TAG_ROBOT: robot_digest(world), **({TAG_WORLD: text} if len(text) <= MAX_WORLD else {})}


def recorded_name(config: Mapping[str, Any]) -> str | None:
    """What the configuration in a bundle's provenance calls the robot; None where it has no name for it."""
    name = config.get("robot_name")
    return name if isinstance(name, str) and re.fullmatch(ROBOT_NAME, name, re.ASCII) else None


def may_name(model: str, world: World, given: str | None) -> bool:
    """Whether a model's name is one of this robot's or of none in particular, as the default is."""
    with suppress(ConfigError):
        if model in {model_name(world, given), model_name(world, given, path=True)}:
            return True
    return model in {MODEL_NAME, PATH_MODEL_NAME} or not model.endswith(_SUFFIX)


def _robot_of(model: str) -> str | None:
    """The robot's name in that of a model; None where it has none."""
    suffix = next((one for one in (_PATH_SUFFIX, _SUFFIX) if model.endswith(one)), None)
    return None if suffix is None else model.removesuffix(suffix)
