"""What the workbench asks of scenes in space and is told, as types."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, Field, Strict

from cspace.query import MAX_SEED
from cspace.view_file import MAX_PICTURES
from inference_api.pages.schemas import RequestFields
from inference_api.workbench.space_faces import Face
from inference_api.workbench.truth_schemas import MODEL_EXPECTED, Number, Row, Rows, WayTruth

_PoseRow = Annotated[tuple[Number, Number, Number, Number], Strict(strict=False)]
_Pose = Annotated[tuple[_PoseRow, _PoseRow, _PoseRow, _PoseRow], Strict(strict=False)]
_Poses = Annotated[tuple[_Pose, ...], Field(min_length=1, max_length=MAX_PICTURES), Strict(strict=False)]


class SpaceRequest(RequestFields):
    """A scene of a family, who looks at it, and what is held against it."""

    EXPECTED: ClassVar[Mapping[str, str]] = {
        "model": MODEL_EXPECTED,
        "family": "a family of the model's robot, or nothing for the first",
        "seed": f"a whole number from 0 to {MAX_SEED}",
        "cameras": f"1 to {MAX_PICTURES} poses, 4 x 4, or nothing for those that the seed draws",
        "state": "an angle in rad for each joint, or nothing for the problem's start",
        "configurations": "arrays of angles in rad",
        "path": "arrays of angles in rad",
    }
    model: str = ""
    family: Annotated[str, Field(max_length=100)] | None = None
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] = 0
    cameras: _Poses | None = None
    state: Row | None = None
    configurations: Rows = ()
    path: Rows = ()


class SpaceAnswer(BaseModel):
    """A scene in space as its cameras see it.

    Args:
        image: base64 of the view file, which the API takes as `image`.
        previews: base64 of PNGs, one for each camera: the nearer, the lighter.
        cameras: as `POST /sample` has them, with width and height.
        faces: of boxes and cylinders, to be painted.
        start: rad; where the arm stands in the pictures.
        goal: rad, of the problem.
        family: whose it is.
        families: of the robot, the first one first.
        sample_free: for each of the configurations.
        way: of the path; None without one.
    """

    image: str
    previews: list[str]
    cameras: list[dict[str, Any]]
    faces: list[Face]
    start: list[float]
    goal: list[float]
    family: str
    families: list[str]
    sample_free: list[bool]
    way: WayTruth | None
