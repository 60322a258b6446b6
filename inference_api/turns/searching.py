"""Requests that search, or draw samples: what they cost, and when others have their turns."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from cspace.bundle.spec import WAYS, BundleSpec
from cspace.query import SampleQuery
from inference_api.failures import NoKernelsError
from inference_api.turns.costs import drawn_for, rows_of
from inference_api.turns.turns import Turn


@contextmanager
def searching(turn: Turn) -> Iterator[Callable[[], None]]:
    """The turn of a request that searches; gives what the search calls now and then.

    Raises:
        NoKernelsError: the compiler of the checks is not installed.
        ClientDisconnect: the client has gone away.
    """
    turn.spend(rows_of(searches=True))
    try:
        yield turn.between
    except ImportError as error:
        raise NoKernelsError(
            "this server does not plan",
            expected="the packages of the extra plan",
            got=f"no {error.name or 'compiler'}",
            remedy="ask a server that has them, or sample here and plan elsewhere",
        ) from error


def paid(
    turn: Turn, spec: BundleSpec, query: SampleQuery, pictures: int = 1
) -> AbstractContextManager[Callable[[], None]]:
    """The turn of a request for samples, paid for; gives what drawing calls between its parts.

    Raises:
        NoKernelsError: the model searches, and the compiler of the checks is not installed.
        ClientDisconnect: the client has gone away.
    """
    if spec.model_kind == WAYS:
        return searching(turn)
    turn.spend(rows_of(drawn=pictures * drawn_for(spec, query)))
    return nullcontext(turn.between)
