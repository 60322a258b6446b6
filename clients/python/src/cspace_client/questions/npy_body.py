"""The body of an answer of the API: a ``.npy`` file from outside, checked before use.

NumPy's own reader evaluates the header as a Python literal, which raises whatever a header likes and takes as
much memory. The API writes one form of header, and that form alone is read.
"""

import re

import numpy as np
from numpy.typing import NDArray

from cspace_client.answer_errors import unusable
from cspace_client.joint_space import JointSpace, circles

NPY = "application/x-npy"
"""Media type."""
MAX_HEAD_BYTES = 256
"""Before the numbers; the API writes 128."""
MAX_JOINTS = 64
"""Of a robot; wider arrays are none of samples."""

_HEAD = re.compile(
    rb"\x93NUMPY\x01\x00"
    rb"(?P<length>[\x00-\xff]{2})"
    rb"\{'descr': '<f4', 'fortran_order': False, "
    rb"'shape': \((?P<n>[0-9]{1,9}), (?P<d>[0-9]{1,9})\), \} {0,240}\n"
)


def max_body_bytes(n: int) -> int:
    """The largest ``.npy`` that holds ``n`` samples of at most ``MAX_JOINTS`` joints."""
    return MAX_HEAD_BYTES + 4 * MAX_JOINTS * n


def read_rows(body: bytes, what: str) -> NDArray[np.float32]:
    """The array of a ``.npy`` file, (n, d) float32, d from 1 to ``MAX_JOINTS``; it shares the file's memory.

    Args:
        body: the file, whole.
        what: it holds, for the error.

    Raises:
        SamplerAnswerError: it is no such file.
    """
    head = _HEAD.match(body, 0, MAX_HEAD_BYTES)
    if head is None or int.from_bytes(head["length"], "little") != head.end() - 10:
        raise unusable(f"is no .npy file of {what}", "float32 of shape (n, d), by rows", repr(body[:80]))
    rows, columns = int(head["n"]), int(head["d"])
    size = len(body) - head.end()
    # Shape against size: a header may claim any shape.
    if not 1 <= columns <= MAX_JOINTS or 4 * rows * columns != size:
        expected = f"rows of 1 to {MAX_JOINTS} numbers, float32"
        raise unusable("holds another array", expected, f"({rows}, {columns}) in {size} bytes")
    return np.frombuffer(body, dtype="<f4", offset=head.end()).reshape(rows, columns)


def read_samples(body: bytes, n: int, space: JointSpace | None = None) -> NDArray[np.float32]:
    """The samples of a ``.npy`` file, (n, d) float32 rad.

    Args:
        body: the file, whole.
        n: how many there have to be.
        space: whose configurations they are; None for circles alone.

    Raises:
        SamplerAnswerError: it is no such file, or holds other numbers than wrapped angles and values within
            limits.
    """
    samples = read_rows(body, "samples")
    rows, joints = samples.shape
    if rows != n:
        raise unusable("has another number of samples", str(n), str(rows))
    if space is not None and space.dim != joints:
        raise unusable("is for another joint space", f"{space.dim} joints", str(joints))
    # As real numbers: float32(pi) lies above pi. A signalling NaN would warn, or raise where warnings do.
    with np.errstate(invalid="ignore"):
        wrong = int(np.sum(~(space or circles(joints)).holds(samples)))
    if wrong and space is not None:
        ends = f"from {space.lower} to {space.upper}"
        raise unusable("holds values outside the joints' limits", ends[:200], f"{wrong} others")
    if wrong:
        raise unusable("holds values that are no wrapped angles", "[-pi, pi)", f"{wrong} others")
    return samples.astype(np.float32, copy=False)
