"""Strict JSON from clients, its work bounded before it is parsed: the parser lets no other thread run."""

from typing import Any

from cspace import strict_json
from inference_api.problems import MALFORMED_BODY, RequestError

# Commas, colons and opening brackets. The largest request for samples has about 1200: two configurations and
# a schedule.
MAX_MARKS = 5_000
# As numbers, 14 pictures of 48 pixels a side; the parser holds the interpreter for about 40 ms.
MAX_TENSOR_MARKS = 100_000
# Reading a whole number takes time with the square of its digits; 8 MiB of long ones would take 0.15 s.
MAX_DIGITS = 1_000
# A text of nothing else would hold the interpreter for 20 ms. Base64 in JSON that escapes slashes has fewer.
MAX_ESCAPES = 200_000
_MARKS = (b",", b":", b"[", b"{")


def parse_json(body: bytes, most: int = MAX_MARKS) -> dict[str, Any]:
    """A JSON object with unique keys and finite numbers.

    Args:
        body: UTF-8.
        most: how many commas, colons and opening brackets it may have.

    Raises:
        RequestError: the body is not that.
    """
    values = load_json("the body", body, most)
    if not isinstance(values, dict):
        raise RequestError(
            MALFORMED_BODY, "the body is no JSON object", expected="an object", got=type(values).__name__
        )
    return values


def load_json(what: str, data: bytes, most: int = MAX_MARKS) -> object:
    """Strict JSON: UTF-8, finite numbers, unique keys.

    Args:
        what: the text's name in messages.
        data: the text.
        most: how many commas, colons and opening brackets it may have.

    Raises:
        RequestError: it is not that.
    """
    marks = sum(map(data.count, _MARKS))
    if marks > most:
        raise RequestError(
            MALFORMED_BODY,
            f"{what} holds too many values",
            expected=f"at most {most} commas, colons and opening brackets",
            got=str(marks),
            remedy="send pictures as PNG, or as binary tensors behind the JSON object",
        )
    escapes = data.count(b"\\")
    if escapes > MAX_ESCAPES:
        raise RequestError(
            MALFORMED_BODY,
            f"{what} holds too many escapes",
            expected=f"at most {MAX_ESCAPES} backslashes",
            got=str(escapes),
            remedy="write texts in UTF-8",
        )
    try:
        # What is infinite is refused where fields are judged, with the field's name.
        return strict_json.parse_json(data, whole=_whole, number=float)
    except ValueError as error:
        raise RequestError(
            MALFORMED_BODY,
            f"{what} is not JSON",
            expected="UTF-8 JSON, not deeply nested, with finite numbers and unique keys",
            got=str(error)[:200],
        ) from error


def _whole(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError(f"a whole number has more than {MAX_DIGITS} digits")
    return int(digits)
