"""The model behind an answer."""

from dataclasses import dataclass

from cspace_client.joint_space import JointSpace


@dataclass(frozen=True, slots=True)
class PictureWarning:
    """Something about the pictures of a request that makes its answer worse or wrong.

    Args:
        code: a name that never changes, as ``no-surface-in-reach``; the API's document lists them.
        message: what was seen, what it does to the answer, and what to do, in the server's words.
        pictures: numbers of the pictures that it is about, from 0; none where it is about all.
    """

    code: str
    message: str
    pictures: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class ModelHead:
    """The model that answered, and what it holds of the picture.

    Args:
        model_name: as :class:`cspace_client.samples.SampleBatch` has it, and so the rest.
        model_version: likewise.
        digest: likewise.
        novelty: likewise.
        space: of its robot; None where it is not told.
        robot: likewise.
        alias_confirmed: likewise.
        warnings: likewise.
    """

    model_name: str
    model_version: int
    digest: str
    novelty: float | None = None
    space: JointSpace | None = None
    robot: str | None = None
    alias_confirmed: bool | None = None
    warnings: tuple[PictureWarning, ...] = ()
