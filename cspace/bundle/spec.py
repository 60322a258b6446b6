"""What a bundle says about itself: the typed twin of ``bundle.json``, validated to the last key."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cspace.bundle.parts import Provenance, RandomInput, one_of
from cspace.bundle.strict_json import StrictObject, parse_json
from cspace.errors import BundleIntegrityError, ScenarioError
from cspace.space import Standardisation, circles
from cspace.world import World
from cspace.worlds import read_world

SCHEMA_VERSION = 3
# Without uniform_share and novelty_quantiles, read as 0 and none; robot and camera of a planar world by
# themselves, read as that.
_WITHOUT_SHARE, _WITHOUT_WORLD = (1,), (1, 2)
KINDS = ("configuration", "path")
MODEL_KINDS = ("generator", "mixture")
ENDPOINTS = ("start", "goal")
PICTURE, MAP = "image", "map"
MIN_PIXELS, MAX_PIXELS = 16, 2048
# What a request draws for one latent is at most so many numbers, and so is what it gets for one.
MAX_PER_LATENT = 4096
MAX_LATENT, MAX_JOINTS, MAX_RANDOM_INPUTS = 1024, 64, 16
MAX_QUANTILES, MAX_SCORES = 1001, 16


@dataclass(frozen=True, slots=True)
class BundleSpec:
    """The contract between a bundle's graphs and whoever samples from them.

    Args:
        world: whose configurations are sampled, and how it is seen; its pixels are the encoder's input size.
        latent_dim: L, size of the encoder's mean and standard deviation.
        kind: ``configuration`` (free configurations) or ``path`` (conditioned on start and goal).
        model_kind: ``generator`` or ``mixture``; both are one graph with the same inputs and outputs.
        looks_at_picture: whether the generator takes the picture itself beside its latent.
        looks_at_map: whether it takes what the map graph makes of the picture, once for all its requests.
        samples_per_latent: K, samples that the generator draws from one latent.
        random_inputs: what the generator takes beside the latent, in the order in which it is drawn.
        standardisation: of the angles inside the graph, for information; the graph's output is in rad.
        confidence_threshold: the validity head's threshold that training recommends, None without one.
        uniform_share: of what the validity head is shown when a request filters: uniform over the joint space
            instead of generated, 0 to below 1; 0 for path models.
        novelty_quantiles: for each score of the novelty graph its rising quantiles over known pictures; None
            without one.
        provenance: how the bundle was made.

    Raises:
        BundleIntegrityError: a value cannot be.
    """

    world: World
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
    novelty_quantiles: tuple[tuple[float, ...], ...] | None = None
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
            "uniform_share" if not 0.0 <= share < 1.0 or (share and self.kind == "path") else "",
            "novelty_quantiles" if not _rise(self.novelty_quantiles) else "",
            "standardisation" if scale is not None and len(scale.mean) != self.dim else "",
        ]
        if any(wrong):
            raise BundleIntegrityError(
                "the bundle's description does not fit",
                expected=f"at most {MAX_JOINTS} joints, a latent of 1..{MAX_LATENT}, {MIN_PIXELS}.."
                f"{MAX_PIXELS} pixels, at most {MAX_PER_LATENT} numbers drawn for a latent and given for it, "
                "different names, a threshold within 0..1, a share below 1, rising quantiles",
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
    def joint_space(self) -> dict[str, Any]:
        """The joint space as ``bundle.json`` and the API's answers write it."""
        return self.world.space.to_dict()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, every field of the schema."""
        scale, quantiles = self.standardisation, self.novelty_quantiles
        return {
            "schema_version": SCHEMA_VERSION,
            "kind": self.kind,
            "world": self.world.to_dict(),
            "joint_space": self.joint_space,
            "image": self.world.sensor.convention,
            "latent_dim": self.latent_dim,
            "model_kind": self.model_kind,
            "samples_per_latent": self.samples_per_latent,
            "random_inputs": [item.to_dict() for item in self.random_inputs],
            "standardisation": None if scale is None else {"mean": list(scale.mean), "std": list(scale.std)},
            "conditions": list(self.conditions),
            "confidence_threshold": self.confidence_threshold,
            "uniform_share": self.uniform_share,
            "novelty_quantiles": None if quantiles is None else [list(row) for row in quantiles],
            "provenance": self.provenance.to_dict(),
        }

    def to_json(self) -> bytes:
        """``bundle.json``, UTF-8.

        Raises:
            BundleIntegrityError: the provenance holds something that JSON does not.
        """
        try:
            text = json.dumps(self.to_dict(), indent=2, sort_keys=True, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise BundleIntegrityError(
                "the bundle's description is not plain JSON",
                expected="finite numbers, texts, lists and mappings",
                got=str(error)[:200],
                remedy="convert arrays, paths and NaN before they enter the provenance",
            ) from error
        return text.encode() + b"\n"

    @classmethod
    def from_dict(cls, values: object) -> "BundleSpec":
        """The inverse of :meth:`to_dict`; every key is required and no other is allowed.

        Raises:
            BundleIntegrityError: the schema version is another, or a key or value does not fit.
        """
        version = _version(values)
        absent = {"uniform_share", "novelty_quantiles"} if version in _WITHOUT_SHARE else set()
        older = version in _WITHOUT_WORLD
        entry = StrictObject("bundle.json", values, (_FIRST_KEYS if older else _KEYS) - absent)
        scale = entry.get("standardisation")
        try:
            spec = cls(
                world=_world(entry, ("robot", "camera") if older else ()),
                latent_dim=entry.integer("latent_dim"),
                kind=entry.text("kind"),
                model_kind=entry.text("model_kind"),
                looks_at_picture=PICTURE in entry.items("conditions"),
                looks_at_map=MAP in entry.items("conditions"),
                samples_per_latent=entry.integer("samples_per_latent"),
                random_inputs=tuple(RandomInput.from_dict(item) for item in entry.items("random_inputs")),
                standardisation=None if scale is None else _standardisation(scale),
                confidence_threshold=entry.number_or_none("confidence_threshold"),
                uniform_share=0.0 if absent else entry.number("uniform_share"),
                novelty_quantiles=None if absent else _quantiles(entry.get("novelty_quantiles")),
                provenance=Provenance.from_dict(entry.get("provenance")),
            )
        except (ScenarioError, ValueError, TypeError, AttributeError) as error:
            # Those that are none of the project's are of a robot whose numbers are no numbers.
            expected = error.expected if isinstance(error, ScenarioError) else "numbers where numbers belong"
            raise BundleIntegrityError(
                "the bundle's description does not fit", expected=expected, got=str(error)[:200]
            ) from error
        # Written before limits were told of; the robot has them.
        torus = entry.get("joint_space") == circles(spec.dim).to_dict()
        for name in ("image", "conditions", *(() if torus else ("joint_space",))):
            entry.must_be(name, spec.to_dict()[name])
        return spec

    @classmethod
    def from_json(cls, data: bytes) -> "BundleSpec":
        """Parse and validate ``bundle.json``.

        Raises:
            BundleIntegrityError: not strict JSON, or not this schema.
        """
        return cls.from_dict(parse_json(data))


_KEYS = {
    "schema_version", "kind", "world", "joint_space", "image", "latent_dim", "model_kind",
    "samples_per_latent", "random_inputs", "standardisation", "conditions", "confidence_threshold",
    "uniform_share", "novelty_quantiles", "provenance",
}  # fmt: skip
_FIRST_KEYS = _KEYS - {"world"} | {"robot", "camera"}


def _version(values: object) -> int:
    version = values.get("schema_version") if isinstance(values, Mapping) else None
    known = (*_WITHOUT_WORLD, SCHEMA_VERSION)
    if version not in known or not isinstance(version, int) or version is True:
        raise BundleIntegrityError(
            "the bundle's schema is another",
            expected=f"schema_version {', '.join(map(str, known))}",
            got=repr(version)[:200],
            remedy="use the release of cspace-sampler that wrote the bundle, or export it again",
        )
    return version


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


def _quantiles(values: object) -> tuple[tuple[float, ...], ...] | None:
    if values is None:
        return None
    rows = values if isinstance(values, list) else [None]
    numbers = [StrictObject("novelty_quantiles", {"row": row}, {"row"}).numbers("row") for row in rows]
    return tuple(tuple(row) for row in numbers)


def _world(entry: StrictObject, parts: tuple[str, ...]) -> World:
    return read_world({name: entry.mapping(name) for name in parts} if parts else entry.mapping("world"))


def _standardisation(values: object) -> Standardisation:
    entry = StrictObject("standardisation", values, {"mean", "std"})
    return Standardisation(tuple(entry.numbers("mean")), tuple(entry.numbers("std")))
