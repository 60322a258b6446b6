"""One request to an inference API, whatever it asks for, and how its answer is read."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from cspace_client.pictures import File, Shown

Found = TypeVar("Found")
Found_co = TypeVar("Found_co", covariant=True)


class Reading(Protocol[Found_co]):
    """An answer whose head fits its question, and whose body follows."""

    @property
    def limit_bytes(self) -> int:
        """The longest body that can be right."""

    def conclude(self, body: bytes, round_trip_s: float) -> Found_co:
        """What the whole answer stands for.

        Args:
            body: whole.
            round_trip_s: how long it took.

        Raises:
            SamplerAnswerError: it can not be used.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Question(ABC, Generic[Found]):
    """One request, which may be sent more than once: its seed makes every answer to it the same.

    Args:
        shown: the picture, as it is sent.
        model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the default.
        robot: that is planned for; None for any.
        tells_robot: whether the robot is sent, which older servers refuse.
    """

    path: ClassVar[str]
    media_type: ClassVar[str]

    shown: Shown
    model: str | None
    robot: str | None
    tells_robot: bool

    @property
    def fields(self) -> dict[str, Any]:
        """The form's fields; what the endpoint takes for granted is left to it."""
        fields = {**self.shown.fields, **self.own_fields()}
        if self.robot is not None and self.tells_robot:
            fields["robot"] = self.robot
        if self.model is not None:
            fields["model"] = self.model
        return fields

    @property
    def files(self) -> list[tuple[str, File]]:
        """The form's files, each with its field."""
        return [*(("image", file) for file in self.shown.files), *self.own_files()]

    @abstractmethod
    def own_fields(self) -> dict[str, Any]:
        """Those that this question has."""

    def own_files(self) -> list[tuple[str, File]]:
        """Files beside the picture, each with its field."""
        return []

    @abstractmethod
    def read(self, headers: Mapping[str, str]) -> Reading[Found]:
        """Judge an answer of status 200 by its head.

        Args:
            headers: of the answer; names in any case if the mapping does not mind it.

        Raises:
            SamplerAnswerError: a header is missing, wrong, or answers another question.
        """
