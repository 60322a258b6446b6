"""One request to an inference API, whatever it asks for, and how its answer is read."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from cspace.png import encode_png
from services.planner.sources.samples import Picture

Found = TypeVar("Found")
Found_co = TypeVar("Found_co", covariant=True)
File = tuple[str, bytes, str]


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
        image: the picture's file.
        model: as :class:`services.planner.sources.samples.SampleSource` has it.
        robot: that is planned for, as :func:`cspace.worlds.robot_digest` names it; None for any.
        require_confirmed: whether only a model is wanted that is sure to be the one that is named.
        tells_robot: whether the robot is sent, which older servers refuse.
    """

    path: ClassVar[str]
    media_type: ClassVar[str]

    image: bytes
    model: str | None
    robot: str | None
    require_confirmed: bool
    tells_robot: bool

    @property
    def fields(self) -> dict[str, Any]:
        """The form's fields; what the endpoint takes for granted is left to it."""
        fields = self.own_fields()
        if self.robot is not None and self.tells_robot:
            fields["robot"] = self.robot
        if self.require_confirmed:
            fields["require_confirmed"] = "true"
        if self.model is not None:
            fields["model"] = self.model
        return fields

    @property
    def files(self) -> dict[str, File]:
        """The form's files: name, content and media type of each field."""
        return {"image": ("scenario.png", self.image, "image/png")} | self.own_files()

    @abstractmethod
    def own_fields(self) -> dict[str, Any]:
        """Those that this question has."""

    def own_files(self) -> dict[str, File]:
        """Files beside the picture."""
        return {}

    @abstractmethod
    def read(self, headers: Mapping[str, str]) -> Reading[Found]:
        """Judge an answer of status 200 by its head.

        Args:
            headers: of the answer; names in any case if the mapping does not mind it.

        Raises:
            SamplerAnswerError: a header is missing, wrong, or answers another question.
        """


def picture_file(picture: Picture) -> bytes:
    """A picture as the file that is sent."""
    return picture if isinstance(picture, bytes) else encode_png(picture)
