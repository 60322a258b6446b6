"""A scene file that was opened in the page, read as the command lines read it; runs in a worker thread."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from fastapi.responses import JSONResponse, Response
from pydantic import Field

from cspace.errors import InputError
from inference_api.models.served import ServedModel
from inference_api.pages.schemas import RequestFields
from inference_api.turns.costs import rows_of
from inference_api.turns.turns import Turn
from inference_api.workbench.truth import telling
from inference_api.workbench.truth_schemas import MODEL_EXPECTED
from services.registry.references import ModelReference

MAX_LETTERS = 2**15
# What errors call it, before the line.
_NAME = Path("the file")


class FileRequest(RequestFields):
    """A scene file's text."""

    EXPECTED: ClassVar[dict[str, str]] = {
        "model": MODEL_EXPECTED,
        "text": f"YAML or JSON of at most {MAX_LETTERS} letters",
    }
    model: str = ""
    text: Annotated[str, Field(max_length=MAX_LETTERS)]


@dataclass(frozen=True, slots=True, eq=False)
class FileQuestion:
    """A scene file; an :class:`~inference_api.pages.exchange.Question`."""

    asked: FileRequest
    reference: ModelReference

    def answer(self, served: ServedModel, turn: Turn) -> Response:  # noqa: ARG002 - files are read without a model
        """What the file says, with all that it leaves out, as a scene file in JSON.

        Raises:
            ScenarioError: it is none, with the line.
            InputError: it is of another world, or holds no obstacles.
        """
        turn.spend(rows_of(searches=True))
        with telling():
            return JSONResponse(_told(self.asked.text))


def _told(text: str) -> dict[str, Any]:
    # Brings packages that a server without the truth does not have.
    from services.scene_files import read_scene_text  # noqa: PLC0415

    # Arms in space are named, and looked for among files.
    found = read_scene_text(text.encode(errors="surrogatepass"), _NAME, ("planar",))
    if found.scene is None:
        raise InputError("the file holds no scene", expected="obstacles, an empty list for none", got="none")
    values = found.scene.to_dict()
    discs = [dict(zip(("x_m", "y_m", "radius_m"), row, strict=True)) for row in values["discs"]]
    ends = {"start": found.start, "goal": found.goal}
    return {"robot": values["robot"], "obstacles": discs} | {
        name: end.tolist() for name, end in ends.items() if end is not None
    }
