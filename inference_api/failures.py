"""Errors that several floors of the API raise or answer."""

from pydantic import BaseModel

from cspace.errors import CspaceError, InputError


class FieldProblem(BaseModel):
    """What is wrong with one field."""

    field: str
    expected: str
    got: str


class FieldsError(InputError):
    """One or more fields are wrong.

    Args:
        problems: one entry a field.
    """

    def __init__(self, problems: list[FieldProblem]) -> None:
        first = problems[0]
        super().__init__(f"{first.field} is wrong", expected=first.expected, got=first.got)
        self.problems = problems


class NoKernelsError(CspaceError):
    """What is asked for needs compiled code that this server has not."""


class StartingError(CspaceError):
    """What is asked for is being loaded since the server was started."""


class NoRoomError(CspaceError):
    """The process may not take as much memory as is needed."""


class ModelNotReadyError(CspaceError):
    """There is no model that could answer."""
