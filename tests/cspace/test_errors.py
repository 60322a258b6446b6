import pickle

import pytest

from cspace import errors

KINDS = [kind for kind in vars(errors).values() if isinstance(kind, type)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_belongs_to_the_one_tree_and_survives_a_process_boundary(kind):
    error = kind("the picture is odd", expected="a square", got="a circle", remedy="draw a square")
    assert isinstance(error, errors.CspaceError)
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301 - made one line above
    assert type(copy) is kind
    assert str(copy) == "the picture is odd; expected a square; got a circle; draw a square"
    assert (copy.what, copy.expected, copy.got, copy.remedy) == (
        error.what, error.expected, error.got, error.remedy,
    )  # fmt: skip
