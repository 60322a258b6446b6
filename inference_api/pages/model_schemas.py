"""What the API tells of models, as types."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field


class JointSpaceInfo(BaseModel):
    """The space that the samples live in: all joints are circles."""

    kind: Literal["torus"]
    dim: int
    unit: Literal["rad"]


class LimitedJointSpaceInfo(BaseModel):
    """The same where joints have limits: all of them in a box, some in a mixed space."""

    kind: Literal["box", "mixed"]
    dim: int
    unit: Literal["rad"]
    lower: list[float] = Field(description="Lower end of each joint's range; -pi of a circle.")
    upper: list[float] = Field(description="Upper end of each joint's range; pi of a circle.")
    periodic: list[bool] = Field(description="Whether each joint is a circle.")


AnyJointSpace = Annotated[JointSpaceInfo | LimitedJointSpaceInfo, Field(discriminator="kind")]


def joint_space_info(space: Mapping[str, Any]) -> JointSpaceInfo | LimitedJointSpaceInfo:
    """A bundle's joint space as answers tell it."""
    return JointSpaceInfo(**space) if space["kind"] == "torus" else LimitedJointSpaceInfo(**space)


class ModelInfo(BaseModel):
    """The model that answered."""

    name: str
    version: int = Field(description="Number in the registry; 0 for the shipped model.")
    alias: str | None = Field(description="By which it was found.")
    run_id: str | None
    digest: str = Field(description="SHA-256 of the bundle's sums.")
    fallback: bool = Field(description="Whether the shipped model stands in for a champion.")
    robot: str = Field(description="Whose configurations are sampled: SHA-256 of the robot in `GET /models`.")
    alias_confirmed: bool = Field(
        description="False where the registry is away, or its version is not loaded yet, so that the alias "
        "(the champion's where none is named) may stand for another version."
    )


class ListedModel(BaseModel):
    """A model that a request can name."""

    reference: str = Field(description="What to write into `model`.")
    name: str
    version: int
    aliases: list[str]
    run_id: str | None
    digest: str
    loaded: bool = Field(description="Whether it is in memory.")
    default: bool = Field(description="Whether it answers requests that name no model.")
    robot: str | None = Field(
        description="Whose configurations are sampled: SHA-256 of the robot; null for versions of releases "
        "that did not tell, until they are loaded."
    )
    world: dict[str, Any] | None = Field(
        description="The robot, with the limits of its joints, and the camera; null as `robot` is, and where "
        "they are too long to be told."
    )
    joint_space: AnyJointSpace | None = Field(description="As in an answer; null as `world` is.")


class ModelList(BaseModel):
    """The models that requests can name."""

    default: str
    registry: Literal["none", "reachable", "unreachable"]
    models: list[ListedModel]
