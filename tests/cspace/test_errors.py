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


def test_what_is_not_known_is_not_said():
    assert str(errors.StorageError("the disk is full")) == "the disk is full"


def test_wrong_values_are_value_errors_as_well():
    assert issubclass(errors.DamagedFileError, ValueError)
    assert not issubclass(errors.BundleError, ValueError)


def test_an_answer_that_can_not_be_used_counts_like_none():
    assert issubclass(errors.SamplerAnswerError, errors.SamplerUnavailableError)
    assert issubclass(errors.SamplerUnavailableError, errors.SamplerError)
