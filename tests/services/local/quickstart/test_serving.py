import httpx
import pytest

from cspace.errors import ServiceStartError
from services.local.quickstart import wait_served

ONE = {"reference": "cspace-sampler/1", "default": True}
TWO = {"reference": "cspace-sampler/2", "default": False}


def api(*answers: object) -> httpx.MockTransport:
    """Gives one answer after the other; the last one stays."""
    left = list(answers)

    def handle(request: httpx.Request) -> httpx.Response:
        assert request.url.path == "/models"
        answer = left.pop(0) if len(left) > 1 else left[0]
        return answer if isinstance(answer, httpx.Response) else httpx.Response(200, json={"models": answer})

    return httpx.MockTransport(handle)


def wait(transport: httpx.MockTransport, *, default: bool, limit_s: float = 60.0) -> list[float]:
    pauses: list[float] = []
    with httpx.Client(transport=transport) as client, pytest.MonkeyPatch.context() as patch:
        patch.setattr(httpx, "get", lambda url, *, params, **_: client.get(url, params=params))
        patch.setattr("services.local.quickstart.time.sleep", pauses.append)
        wait_served("http://api", "cspace-sampler/2", default=default, limit_s=limit_s)
    return pauses


def test_a_listed_version_needs_no_wait() -> None:
    assert wait(api([ONE, TWO]), default=False) == []


def test_a_promoted_version_is_waited_for_until_it_is_the_default() -> None:
    promoted = [ONE | {"default": False}, TWO | {"default": True}]
    assert len(wait(api([ONE], [ONE, TWO], promoted), default=True)) == 2


def test_answers_that_are_errors_or_no_lists_are_waited_out() -> None:
    broken = [httpx.Response(503), httpx.Response(200, text="<html>"), httpx.Response(200, json=[1])]
    assert len(wait(api(*broken, [TWO]), default=False)) == 3


def test_a_version_that_never_comes_is_an_error_that_says_what_is_served() -> None:
    with pytest.raises(ServiceStartError, match=r"cspace-sampler/2.*cspace-sampler/1"):
        wait(api([ONE]), default=False, limit_s=0.0)
