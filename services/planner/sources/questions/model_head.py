"""What the headers of an inference API's ``.npy`` answers say of the model that answered."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cspace.errors import InputError
from cspace.query import is_digest
from cspace.space import MAX_LIMIT_RAD, JointSpace, circles
from cspace.strict_json import parse_json, read_mapping, read_object
from services.planner.sources.answer_errors import unusable
from services.planner.sources.questions.npy_body import MAX_JOINTS

_PRETRAINED = "pretrained"
_MAX_TEXT = 256


@dataclass(frozen=True, slots=True)
class ModelHead:
    """The model that answered, and what it holds of the picture.

    Args:
        model_name: as :class:`services.planner.sources.samples.SampleBatch` has it, and so the rest.
        model_version: likewise.
        digest: likewise.
        novelty: likewise.
        space: of its robot; None where it is not told.
        robot: likewise.
        alias_confirmed: likewise.
    """

    model_name: str
    model_version: int
    digest: str
    novelty: float | None = None
    space: JointSpace | None = None
    robot: str | None = None
    alias_confirmed: bool | None = None


def read_media_type(headers: Mapping[str, str], expected: str) -> None:
    """Refuse an answer of another media type.

    Raises:
        SamplerAnswerError: it is another.
    """
    media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != expected:
        raise unusable("has another media type", expected, repr(media_type))


def read_model_head(headers: Mapping[str, str], model: str | None, robot: str | None) -> ModelHead:
    """The model's headers of an answer.

    Args:
        headers: of the answer.
        model: that was asked for; None for the default.
        robot: that is planned for; None for any.

    Raises:
        SamplerAnswerError: a header is missing or wrong, or the model another.
    """
    name, version = text(headers, "x-model-name"), count(headers, "x-model-version", 9)
    told = digest(headers, "x-robot") if "x-robot" in headers else None
    require_asked(model, robot, name, version, told)
    return ModelHead(
        model_name=name,
        model_version=version,
        digest=digest(headers, "x-model-digest"),
        novelty=share(headers, "x-novelty") if "x-novelty" in headers else None,
        space=read_space(headers["x-joint-space"]) if "x-joint-space" in headers else None,
        robot=told,
        alias_confirmed=_flag(headers, "x-alias-confirmed") if "x-alias-confirmed" in headers else None,
    )


def require_asked(
    model: str | None, robot: str | None, name: str, version: int, told_robot: str | None
) -> None:
    """Refuse the answer of another model than was asked for, or of one of another robot.

    Raises:
        SamplerAnswerError: it is one.
    """
    if not _answers(model, name, version):
        raise unusable("comes from another model", str(model), f"{name}/{version}")
    if told_robot is not None and robot not in (None, told_robot):
        raise unusable("is of another robot", str(robot), told_robot)


def read_space(header: str) -> JointSpace:
    """The joint space that an answer's header says it is of.

    Raises:
        SamplerAnswerError: it says none.
    """
    try:
        said = parse_json(header.encode())
    except ValueError:
        said = None
    return space_of(said, f"header x-joint-space: {header[:80]}")


def space_of(said: object, told: str) -> JointSpace:
    """A joint space as plain values tell it.

    Args:
        said: the values.
        told: where they stand, for the error.

    Raises:
        SamplerAnswerError: they tell none.
    """
    try:
        members = read_mapping(said, "the joint space", InputError)
        space = _space_of(members)
    except ValueError:
        members, space = {}, None
    if space is None or space.to_dict() != members:
        raise unusable("has a wrong joint space", "a joint space as JSON", told)
    return space


def _space_of(said: dict[str, Any]) -> JointSpace | None:
    dim = said.get("dim")
    if not isinstance(dim, int) or not 1 <= dim <= MAX_JOINTS:
        return None
    if said.get("kind") == "torus":
        return circles(dim)
    limits = {name: value for name, value in said.items() if name not in ("kind", "dim", "unit")}
    space = read_object(JointSpace, limits, "the joint space", InputError)
    joints = zip(space.lower, space.upper, space.periodic, strict=True)
    fits = all(-MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD for low, high, _ in joints)
    return space if fits else None


def _answers(asked: str | None, name: str, version: int) -> bool:
    """Whether a model is the one that a reference names.

    A shipped model stands in for a model of its robot without a champion. Which model is the default only
    the server knows, so it may do that for every bare name; an alias or a version has no stand-in.
    """
    if asked is None:
        return True
    asked_name, slash, asked_version = asked.partition("/")
    if slash:
        return (name, str(version)) == (asked_name, asked_version)
    bare, at, _ = asked.partition("@")
    shipped = version == 0 and name.partition("-")[0] == _PRETRAINED
    return name == bare or (not at and shipped)


def text(headers: Mapping[str, str], name: str) -> str:
    """A header's short printable text."""
    value = headers.get(name, "")
    if not value:
        raise unusable("lacks a header", name, "nothing")
    if len(value) > _MAX_TEXT or not (value.isascii() and value.isprintable()):
        expected = f"at most {_MAX_TEXT} printable ASCII characters"
        raise unusable(f"has a wrong header {name}", expected, repr(value[:40]))
    return value


def count(headers: Mapping[str, str], name: str, digits: int) -> int:
    """A header's whole number of at most so many digits."""
    value = text(headers, name)
    if not (value.isdigit() and len(value) <= digits):
        raise unusable(f"has a wrong header {name}", "a whole number", repr(value[:40]))
    return int(value)


def digest(headers: Mapping[str, str], name: str) -> str:
    """A header's SHA-256."""
    value = text(headers, name)
    if not is_digest(value):
        raise unusable(f"has a wrong header {name}", "a SHA-256 in hexadecimal", repr(value[:80]))
    return value


def share(headers: Mapping[str, str], name: str) -> float:
    """A header's number from 0 to 1."""
    value = text(headers, name)
    try:
        found = float(value)
    except ValueError:
        found = math.nan
    if not 0.0 <= found <= 1.0:
        raise unusable(f"has a wrong header {name}", "a number from 0 to 1", repr(value[:40]))
    return found


def _flag(headers: Mapping[str, str], name: str) -> bool:
    value = text(headers, name)
    if value not in ("true", "false"):
        raise unusable(f"has a wrong header {name}", "true or false", repr(value[:40]))
    return value == "true"
