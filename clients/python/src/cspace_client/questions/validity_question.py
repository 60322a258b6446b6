"""``POST /validity`` as clients ask it."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.answer_errors import unusable
from cspace_client.errors import SamplerError
from cspace_client.model import ModelHead
from cspace_client.pictures import File
from cspace_client.questions.model_head import read_media_type, read_model_head, share
from cspace_client.questions.npy_body import MAX_HEAD_BYTES, MAX_JOINTS, NPY, read_rows
from cspace_client.questions.question import Question
from cspace_client.samples import MAX_SAMPLES


@dataclass(frozen=True, slots=True, eq=False)
class Beliefs:
    """What a model holds of configurations.

    Args:
        confidence: (n,) float32, probability that each is free.
        unseen: (n,) float32, share of the robot that no picture shows; None in worlds that are seen whole.
        threshold: the confidence that training recommends to ask for; None without one.
        model: that answered.
        round_trip_s: from the request to the checked answer, further attempts included.
    """

    confidence: NDArray[np.float32]
    unseen: NDArray[np.float32] | None
    threshold: float | None
    model: ModelHead
    round_trip_s: float


@dataclass(frozen=True, slots=True, eq=False)
class ValidityQuestion(Question[Beliefs]):
    """A request for what a model holds of configurations.

    Args:
        configurations: (n, d) float64 rad; see :func:`rows_of`.
    """

    path: ClassVar[str] = "/validity"
    media_type: ClassVar[str] = NPY

    configurations: NDArray[np.float64]

    def own_fields(self) -> dict[str, Any]:
        """None: the configurations are a file."""
        return {}

    def own_files(self) -> list[tuple[str, File]]:
        """As a ``.npy``, which is shorter than JSON and exact."""
        file = io.BytesIO()
        np.save(file, np.ascontiguousarray(self.configurations, dtype="<f8"), allow_pickle=False)
        return [("configurations", ("configurations.npy", file.getvalue(), NPY))]

    def read(self, headers: Mapping[str, str]) -> "ValidityReading":
        """See :class:`cspace_client.questions.question.Question`."""
        read_media_type(headers, NPY)
        threshold = share(headers, "x-threshold") if "x-threshold" in headers else None
        head = read_model_head(headers, self.model, self.robot)
        return ValidityReading(len(self.configurations), threshold, head)


@dataclass(frozen=True, slots=True)
class ValidityReading:
    """See :class:`cspace_client.questions.question.Reading`."""

    rows: int
    threshold: float | None
    head: ModelHead

    @property
    def limit_bytes(self) -> int:
        """Two columns of float32."""
        return MAX_HEAD_BYTES + 8 * self.rows

    def conclude(self, body: bytes, round_trip_s: float) -> Beliefs:
        """The beliefs: shares from 0 to 1, where a second column is that or nowhere a number."""
        columns = read_rows(body, "beliefs")
        if columns.shape != (self.rows, 2):
            raise unusable("holds another array", f"({self.rows}, 2)", str(columns.shape))
        confidence, unseen = columns[:, 0].copy(), columns[:, 1].copy()
        nowhere = bool(np.isnan(unseen).all())
        known = confidence if nowhere else columns
        # What is not a number is neither.
        if not ((known >= 0.0) & (known <= 1.0)).all():
            raise unusable("holds values that are no shares", "0 to 1", "others")
        return Beliefs(confidence, None if nowhere else unseen, self.threshold, self.head, round_trip_s)


def rows_of(configurations: ArrayLike) -> NDArray[np.float64]:
    """Configurations as a request can hold them, (n, d) float64.

    Raises:
        SamplerError: they are not 1 to ``MAX_SAMPLES`` rows of finite angles.
    """
    rows = np.asarray(configurations, dtype=np.float64)
    fits = rows.ndim == 2 and 1 <= len(rows) <= MAX_SAMPLES and 1 <= rows.shape[1] <= MAX_JOINTS
    if not fits or not np.isfinite(rows).all():
        raise SamplerError(
            "the configurations can not be asked about",
            expected=f"1 to {MAX_SAMPLES} rows of finite angles in rad",
            got=f"shape {rows.shape}" if not fits else "values that are not finite",
        )
    return rows
