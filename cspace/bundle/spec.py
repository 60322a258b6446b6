"""What a bundle says about itself: the typed twin of ``bundle.json``, validated to the last key."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

import numpy as np

from cspace.bundle.files import LIMITS_BYTES, SPEC_FILE
from cspace.bundle.parts import Provenance, RandomInput, one_of
from cspace.errors import BundleIntegrityError, ScenarioError
from cspace.space import Standardisation
from cspace.strict_json import json_text, parse_json, read_members, read_object, written
from cspace.world import World
from cspace.worlds import read_world

SCHEMA_VERSION = 5
KINDS = ("configuration", "path")
WAYS = "ways"
MODEL_KINDS = ("generator", "mixture", WAYS)
ENDPOINTS = ("start", "goal")
PICTURE, MAP = "image", "map"
MIN_PIXELS, MAX_PIXELS = 16, 2048
# What a request draws for one latent is at most so many numbers, and so is what it gets for one.
MAX_PER_LATENT = 4096
MAX_LATENT, MAX_JOINTS, MAX_RANDOM_INPUTS = 1024, 64, 16
MAX_QUANTILES, MAX_SCORES, MAX_DOUBT = 1001, 16, 100.0
# Of a plan that is asked for without saying how sure it has to be, where plans are calibrated: on validation
# problems it leaves 95 % of all solved.
PLAN_CONFIDENCE = 0.2
MAX_BYTES, MAX_DEPTH = LIMITS_BYTES[SPEC_FILE], 32


@dataclass(frozen=True, slots=True)
class BundleSpec:
    """The contract between a bundle's graphs and whoever samples from them.

    Args:
        world: whose configurations are sampled, and how it is seen; its pixels are the encoder's input size.
        latent_dim: L, size of the encoder's mean and standard deviation.
        kind: ``configuration`` (free configurations) or ``path`` (conditioned on start and goal).
        model_kind: ``generator`` or ``mixture``, both one graph with the same inputs and outputs; or
            ``ways``, a path sampler that searches and has no such graph.
        looks_at_picture: whether the generator takes the picture itself beside its latent.
        looks_at_map: whether it takes what the map graph makes of the picture, once for all its requests.
        samples_per_latent: K, samples that the generator draws from one latent.
        random_inputs: what the generator takes beside the latent, in the order in which it is drawn.
        standardisation: of the angles inside the graph, for information; the graph's output is in rad.
        confidence_threshold: the validity head's threshold that training recommends, None without one.
        uniform_share: of what the validity head is shown when a request filters: uniform over the joint space
            instead of generated, 0 to 1; 0 for path models.
        passing_share: of what such a request draws first, that is expected to reach the threshold, above 0 to
            1; None where nobody measured it.
        novelty_quantiles: for each score of the novelty graph its rising quantiles over known pictures; None
            without one.
        plan_doubt: (a, b), by which a way of doubt D is free with exp(-exp(a + b log D)), b above 0; see
            :mod:`cspace.planning.cost`. None for (0, 1).
        provenance: how the bundle was made.

    Raises:
        BundleIntegrityError: a value cannot be.
    """

    world: Annotated[World, read_world]
    latent_dim: int
    kind: str = "configuration"
    model_kind: str = "generator"
    looks_at_picture: bool = False
    looks_at_map: bool = False
    samples_per_latent: int = 1
    random_inputs: tuple[RandomInput, ...] = ()
    standardisation: Standardisation | None = None
    confidence_threshold: float | None = None
    uniform_share: float = 0.0
    passing_share: float | None = None
    novelty_quantiles: tuple[tuple[float, ...], ...] | None = None
    plan_doubt: tuple[float, float] | None = None
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        one_of("the kind of the bundle", self.kind, KINDS)
        one_of("the model kind of the bundle", self.model_kind, MODEL_KINDS)
        names = [item.name for item in self.random_inputs]
        threshold, share, scale = self.confidence_threshold, self.uniform_share, self.standardisation
        wrong = [
            "world" if self.dim > MAX_JOINTS else "",
            "latent_dim" if not 1 <= self.latent_dim <= MAX_LATENT else "",
            "samples_per_latent" if not 1 <= self.samples_per_latent * self.dim <= MAX_PER_LATENT else "",
            "pixels" if not MIN_PIXELS <= self.pixels <= MAX_PIXELS else "",
            "random_inputs" if len(set(names)) != len(names) or self._draws_too_much() else "",
            "confidence_threshold" if threshold is not None and not 0.0 <= threshold <= 1.0 else "",
            "uniform_share" if not 0.0 <= share <= 1.0 or (share and self.kind == "path") else "",
            "passing_share" if self.passing_share is not None and not 0.0 < self.passing_share <= 1.0 else "",
            "novelty_quantiles" if not _rise(self.novelty_quantiles) else "",
            "standardisation" if scale is not None and len(scale.mean) != self.dim else "",
            "plan_doubt" if not _is_doubt(self.plan_doubt) else "",
            "kind" if self.model_kind == WAYS and self.kind != "path" else "",
        ]
        if any(wrong):
            raise BundleIntegrityError(
                "the bundle's description does not fit",
                expected=f"at most {MAX_JOINTS} joints, a latent of 1..{MAX_LATENT}, {MIN_PIXELS}.."
                f"{MAX_PIXELS} pixels, at most {MAX_PER_LATENT} numbers drawn for a latent and given for it, "
                "different names, a threshold and shares within 0..1, quantiles and a doubt that rise",
                got=", ".join(f"{name} = {getattr(self, name)!r}"[:200] for name in wrong if name),
            )

    def _draws_too_much(self) -> bool:
        drawn = sum(math.prod(item.shape) for item in self.random_inputs)
        return drawn > MAX_PER_LATENT or len(self.random_inputs) > MAX_RANDOM_INPUTS

    @property
    def dim(self) -> int:
        """d, number of joints."""
        return self.world.dim

    @property
    def pixels(self) -> int:
        """P, side of the picture that the encoder takes."""
        return self.world.sensor.pixels

    @property
    def conditions(self) -> tuple[str, ...]:
        """What the generator takes beside the latent: the picture, its map, start and goal, or nothing."""
        seen = {PICTURE: self.looks_at_picture, MAP: self.looks_at_map}
        return (*(name for name, taken in seen.items() if taken), *self.endpoints)

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Configurations that the generator is conditioned on."""
        return ENDPOINTS if self.kind == "path" else ()

    @property
    def plan_confidence(self) -> float:
        """How sure a way has to be where nobody says so: what is not calibrated rules nothing out."""
        return 0.0 if self.plan_doubt is None else PLAN_CONFIDENCE

    @property
    def joint_space(self) -> dict[str, Any]:
        """The joint space as ``bundle.json`` and the API's answers write it."""
        return self.world.space.to_dict()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, every field of the schema."""
        told = {name: value for name, value in written(self).items() if name not in _LOOKS}
        return told | {"schema_version": SCHEMA_VERSION} | self.derived

    @property
    def derived(self) -> dict[str, Any]:
        """What ``bundle.json`` tells beside the fields, for it follows from them."""
        return {
            "joint_space": self.joint_space,
            "image": self.world.sensor.convention,
            "conditions": list(self.conditions),
        }

    def to_json(self) -> bytes:
        """``bundle.json``, UTF-8.

        Raises:
            BundleIntegrityError: the provenance holds something that JSON does not.
        """
        what = "the bundle's description"
        return json_text(self.to_dict(), what, "provenance", BundleIntegrityError).encode()

    @classmethod
    def from_dict(cls, values: object) -> "BundleSpec":
        """The inverse of :meth:`to_dict`; every key is required and no other is allowed.

        Raises:
            BundleIntegrityError: the schema version is another, or a key or value does not fit.
        """
        members = _members(values)
        derived = {name: members.pop(name) for name in _DERIVED}
        for name, condition in _LOOKS.items():
            members[name] = isinstance(derived["conditions"], list) and condition in derived["conditions"]
        try:
            spec = read_object(cls, members, SPEC_FILE, BundleIntegrityError)
        except ScenarioError as error:
            raise BundleIntegrityError(
                "the bundle's description does not fit", expected=error.expected, got=str(error)[:200]
            ) from error
        for name, value in derived.items():
            if value != spec.derived[name]:
                expected = json.dumps(spec.derived[name])
                raise BundleIntegrityError(
                    f"{SPEC_FILE}: {name} does not fit", expected=expected, got=repr(value)[:200]
                )
        return spec

    @classmethod
    def from_json(cls, data: bytes) -> "BundleSpec":
        """Parse and validate ``bundle.json``.

        Raises:
            BundleIntegrityError: not strict JSON, or not this schema.
        """
        try:
            values = _parsed(data)
        except ValueError as error:
            raise BundleIntegrityError(
                "the bundle's description is not JSON",
                expected=f"UTF-8 JSON of at most {MAX_BYTES} bytes, {MAX_DEPTH} deep, with finite numbers of "
                "64 bits and unique keys",
                got=str(error)[:200],
            ) from error
        return cls.from_dict(values)


# What follows from the other members.
_DERIVED = ("joint_space", "image", "conditions")
_LOOKS = {"looks_at_picture": PICTURE, "looks_at_map": MAP}
_KEYS = {item.name for item in fields(BundleSpec)} - set(_LOOKS) | {"schema_version", *_DERIVED}


def _members(values: object) -> dict[str, Any]:
    """The members of a description without the version of its schema."""
    version = values.get("schema_version") if isinstance(values, Mapping) else None
    if version != SCHEMA_VERSION or not isinstance(version, int):
        raise BundleIntegrityError(
            "the bundle's schema is another",
            expected=f"schema_version {SCHEMA_VERSION}",
            got=repr(version)[:200],
            remedy="use the release of cspace-sampler that wrote the bundle, or export it again",
        )
    members = read_members(values, _KEYS, SPEC_FILE, BundleIntegrityError)
    del members["schema_version"]
    return members


def _is_doubt(values: tuple[float, float] | None) -> bool:
    return values is None or (abs(values[0]) <= MAX_DOUBT and 0.0 < values[1] <= MAX_DOUBT)


def _rise(quantiles: tuple[tuple[float, ...], ...] | None) -> bool:
    if quantiles is None:
        return True
    if len(quantiles) > MAX_SCORES:
        return False
    rows = [np.asarray(row, dtype=np.float64) for row in quantiles]
    rising = (
        1 < len(row) <= MAX_QUANTILES and np.isfinite(row).all() and (np.diff(row) >= 0.0).all()
        for row in rows
    )
    return bool(rows) and all(rising)


def _parsed(data: bytes) -> object:
    """Bounded size and nesting, so that nothing later recurses too deep; texts that can be written again."""
    if len(data) > MAX_BYTES:
        raise ValueError(f"{len(data)} bytes")
    values = parse_json(data)
    layer = [values]
    for _ in range(MAX_DEPTH + 1):
        if not layer:
            return values
        below: list[object] = []
        for value in layer:
            if isinstance(value, dict):
                below += [*value, *value.values()]
            elif isinstance(value, list):
                below += value
            elif isinstance(value, str):
                value.encode()
        layer = below
    raise ValueError(f"nested more than {MAX_DEPTH} deep")
