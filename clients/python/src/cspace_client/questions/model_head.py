"""What the headers of an inference API's ``.npy`` answers say of the model that answered."""

import math
from collections.abc import Mapping
from typing import Any

from cspace_client.answer_errors import printable, unusable
from cspace_client.joint_space import MAX_LIMIT_RAD, JointSpace, circles
from cspace_client.model import ModelHead, PictureWarning
from cspace_client.questions.npy_body import MAX_JOINTS
from cspace_client.samples import is_digest
from cspace_client.strict_json import Members, parse_json

_PRETRAINED = "pretrained"
_MAX_TEXT = 256
_MAX_WARNINGS, _MAX_MESSAGE = 8192, 1000
_ENDS = ("lower", "upper", "periodic")


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
        warnings=read_warnings(headers.get("x-warnings", "[]")),
    )


def read_warnings(header: str) -> tuple[PictureWarning, ...]:
    """The warnings of an answer's header.

    Raises:
        SamplerAnswerError: it holds none.
    """
    try:
        said = parse_json(header.encode()) if len(header) <= _MAX_WARNINGS else header
    except ValueError:
        said = header
    return warnings_of(Members({"warnings": said}, "list of warnings"))


def warnings_of(told: Members) -> tuple[PictureWarning, ...]:
    """The member ``warnings`` of an answer.

    Raises:
        SamplerAnswerError: it holds none.
    """
    return tuple(
        PictureWarning(
            printable(one.text("code", _MAX_TEXT)),
            printable(one.text("message"), _MAX_MESSAGE),
            tuple(int(number) for number in one.row("pictures")),
        )
        for one in told.each("warnings")
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
    members = dict(said) if isinstance(said, Mapping) else {}
    kind, dim, unit = (members.pop(name, None) for name in ("kind", "dim", "unit"))
    space = _space_of(members, dim) if type(dim) is int and 1 <= dim <= MAX_JOINTS else None
    if space is None or unit != "rad" or kind != _kind(space):
        raise unusable("has a wrong joint space", "a joint space as JSON", told)
    return space


def _kind(space: JointSpace) -> str:
    return "torus" if all(space.periodic) else "mixed" if any(space.periodic) else "box"


def _space_of(said: dict[str, Any], dim: int) -> JointSpace | None:
    if not said:
        return circles(dim)
    columns = [said.get(name) for name in _ENDS]
    if set(said) != set(_ENDS) or not all(isinstance(one, list) and len(one) == dim for one in columns):
        return None
    joints = list(zip(*columns, strict=True))
    if not all(type(wraps) is bool and _is_range(low, high) for low, high, wraps in joints):
        return None
    space = JointSpace(*(tuple(one) for one in zip(*joints, strict=True)))
    # Circles alone are told by their number.
    return None if all(space.periodic) else space


def _is_range(low: object, high: object) -> bool:
    numbers = type(low) in (int, float) and type(high) in (int, float)
    return numbers and -MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD  # type: ignore[operator]


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
