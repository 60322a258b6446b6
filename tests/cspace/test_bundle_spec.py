import dataclasses
import json
from typing import Any

import pytest

from cspace.bundle import BundleSpec, Provenance
from cspace.bundle.spec import Standardisation
from cspace.errors import BundleIntegrityError
from cspace.worlds.planar.arm import THREE_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.bundles import tiny_spec


def full_spec() -> BundleSpec:
    return dataclasses.replace(
        tiny_spec(THREE_LINK, kind="path", samples_per_latent=4, model_kind="mixture"),
        world=PlanarWorld(THREE_LINK, Camera(pixels=32)),
        standardisation=Standardisation((0.0, 0.1, 0.2), (1.0, 2.0, 3.0)),
        confidence_threshold=0.8,
        novelty_quantiles=((0.0, 0.5, 1.0), (0.0, 0.0, 2.0)),
        plan_calibration=((0.3, 0.8), (0.1, 0.7)),
        provenance=Provenance(
            git_commit="abc",
            git_dirty=True,
            data_digest="d" * 64,
            seeds={"vae": 1},
            config={"k": [1, {"a": None}]},
            metrics={"edr": 0.1},
            created="2026-11-01T00:00:00+00:00",
            command="train",
        ),
    )


@pytest.mark.parametrize("spec", [tiny_spec(), tiny_spec(THREE_LINK), full_spec()])
def test_a_description_survives_the_way_through_json(spec: BundleSpec) -> None:
    assert BundleSpec.from_json(spec.to_json()) == spec


WORLD = full_spec().world.to_dict()
CHANGES: list[dict[str, Any]] = [
    {"schema_version": 5},
    {"plan_calibration": [[0.0, 1.0], [0.0, -1.0]]},
    {"plan_calibration": [[0.0, 1.0]] * 5},
    {"kind": "paths"},
    {"model_kind": "flow"},
    {"world": WORLD | {"robot": {"kind": "humanoid"}}},
    {"joint_space": {"kind": "torus", "dim": 3, "unit": "deg"}},
    {"image": {"pixels": 32, "channels": "BGR", "range": [-1, 1]}},
    {"world": WORLD | {"camera": WORLD["camera"] | {"pixels": 100_000}}},
    {"world": WORLD | {"robot": WORLD["robot"] | {"link_lengths_m": [1.0] * 1000}}},
    {"latent_dim": 0},
    {"random_inputs": [{"name": "u"}]},
    {"standardisation": {"mean": [0.0], "std": [1.0]}},
    {"standardisation": {"mean": [0, 0, 0], "std": [1, 0, 1]}},
    {"standardisation": {"mean": [0, 0, 0], "std": [1, 1]}},
    {"conditions": []},
    {"confidence_threshold": 1.5},
    {"novelty_quantiles": [[0.0, 1.0], [1.0, 0.5]]},
    {"provenance": {"by": "somebody"}},
    {"surprise": 1},
]


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: str(change)[:60])
def test_a_description_with_a_wrong_value_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BundleIntegrityError):
        BundleSpec.from_json(json.dumps({**json.loads(full_spec().to_json()), **change}).encode())


def test_what_is_no_description_is_refused() -> None:
    for data in (b"[]", b"{", b'{"a": NaN}'):
        with pytest.raises(BundleIntegrityError):
            BundleSpec.from_json(data)
