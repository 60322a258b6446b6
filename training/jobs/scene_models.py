"""Scene models as versions of the registered model ``scene-model``; weights lie with the run of each."""

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cspace.errors import BundleIntegrityError, InputError, ModelNotFoundError
from cspace.files import replacing
from services.names import (
    ALIAS_CHALLENGER,
    ALIAS_CHAMPION,
    SCENE_MODEL_FILE,
    SCENE_MODEL_NAME,
    SCENE_MODELS_EXPERIMENT,
    TAG_DIGEST,
    TAG_STAGE,
)
from services.registry.entities import ID, ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking

# How many more of those that pass may be in collision for an arm, before a model is no better.
_MARGIN = 0.005
ACCURACY, FALSE_FREE = "accuracy", "false_free_above_0.9"

Figures = Mapping[str, Mapping[str, float]]


def register(
    file: Path, figures: Figures, params: Mapping[str, Any], tracking: Tracking, registry: ModelRegistry
) -> ModelVersion:
    """Make weights a version: the champion where they are better than those of the one before.

    Better is a higher accuracy on average over the held-out arms, with no arm for which 0.5 percentage points
    more of what passes a confidence of 0.9 are in collision. The same weights are registered once.
    """
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    flat = {f"{arm}.{name}": value for arm, found in figures.items() for name, value in found.items()}
    champion = None
    with suppress(ModelNotFoundError):
        champion = registry.by_alias(SCENE_MODEL_NAME, ALIAS_CHAMPION)
    is_champion = champion is None or champion.digest == digest or _is_better(figures, champion.tags)
    tags = {TAG_STAGE: "scene model", TAG_DIGEST: digest}
    with tracking.start(SCENE_MODELS_EXPERIMENT, f"scene model, {ID}", tags=tags, key=digest) as run:
        run.params(params)
        run.metrics(flat, 0)
        run.artifact(file)
    alias = ALIAS_CHAMPION if is_champion else ALIAS_CHALLENGER
    values = {name: repr(value) for name, value in flat.items()}
    return registry.record(SCENE_MODEL_NAME, run.run_id, {TAG_DIGEST: digest, **values}, alias=alias)


def fetch(reference: str, file: Path, tracking: Tracking, registry: ModelRegistry) -> ModelVersion:
    """Write the weights of a version."""
    named = ModelReference.parse(reference)
    if named.name != SCENE_MODEL_NAME:
        raise InputError(
            "the reference is of no scene model", expected=f"{SCENE_MODEL_NAME}@champion", got=reference
        )
    version = registry.look_up(named)
    with TemporaryDirectory() as folder:
        kept = tracking.file(version.run_id, SCENE_MODEL_FILE, Path(folder))
        if kept is None:
            raise ModelNotFoundError(f"the run of {version} keeps no weights", expected=SCENE_MODEL_FILE)
        data = kept.read_bytes()
    if (found := hashlib.sha256(data).hexdigest()) != version.digest:
        raise BundleIntegrityError(
            f"the weights of {version} are not those that were registered", expected=version.digest, got=found
        )
    with replacing(file, "the scene model") as beside:
        beside.write_bytes(data)
    return version


def _is_better(figures: Figures, before: Mapping[str, str]) -> bool:
    gained = 0.0
    for arm, found in figures.items():
        # An arm that the champion was not measured with says nothing.
        if f"{arm}.{ACCURACY}" not in before:
            continue
        accuracy, false_free = (float(before[f"{arm}.{name}"]) for name in (ACCURACY, FALSE_FREE))
        if found[FALSE_FREE] > false_free + _MARGIN:
            return False
        gained += found[ACCURACY] - accuracy
    return gained > 0.0
