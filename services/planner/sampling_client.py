"""The HTTP client of ``POST /sample``."""

import json
import math
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

import httpx

from cspace.errors import ConfigError, SamplerError, SamplerUnavailableError
from services.planner.npy_answer import NPY, read_batch
from services.planner.samples import SampleBatch

__all__ = ["SampleBatch", "SamplingClient"]

DEFAULT_TIMEOUT_S = 10.0
_START_REMEDY = "check that the inference API runs and that the address is right"


class SamplingClient:
    """Asks an inference API for samples over one kept connection. Use as a context manager, or close it.

    A request costs about 1 ms beside the server's work; never send one from a planner's callback, which would
    stop the search (and the interpreter) for as long.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``.
        timeout_s: for connecting, and for each read and write.
        transport: of httpx; None for the network.

    Raises:
        ConfigError: the address or the time limit can not be.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        if not 0.0 < timeout_s < math.inf:
            raise ConfigError(
                "the client's time limit is out of range", expected="above 0", got=repr(timeout_s)
            )
        self.url = _checked(url)
        # Without the environment's proxies: the API is a neighbour, and loopback must not leave the machine.
        self._http = httpx.Client(timeout=timeout_s, trust_env=False, transport=transport)

    def sample(
        self,
        image_png: bytes,
        n: int,
        *,
        model: str | None = None,
        seed: int | None = None,
        epsilon_sigma: Sequence[float] = (),
        start: Sequence[float] | None = None,
        goal: Sequence[float] | None = None,
        min_confidence: float | None = None,
    ) -> SampleBatch:
        """See :class:`services.planner.samples.SampleSource`.

        Raises:
            SamplerUnavailableError: no connection, no answer in time, or no model ready (503).
            SamplerError: the request was refused, or the answer can not be used.
        """
        fields: dict[str, Any] = {"n": str(n)}
        fields |= {} if min_confidence is None else {"min_confidence": repr(float(min_confidence))}
        fields |= {} if model is None else {"model": model}
        fields |= {} if seed is None else {"seed": str(seed)}
        fields |= {"epsilon_sigma": [repr(float(value)) for value in epsilon_sigma]} if epsilon_sigma else {}
        for name, angles in (("start", start), ("goal", goal)):
            fields |= {} if angles is None else {name: json.dumps([float(angle) for angle in angles])}
        began = time.perf_counter()
        answer = self._post(fields, image_png)
        if answer.status_code != httpx.codes.OK:
            raise _refusal(answer)
        return read_batch(answer.content, answer.headers, n, time.perf_counter() - began)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _post(self, fields: Mapping[str, Any], image_png: bytes) -> httpx.Response:
        try:
            return self._http.post(
                f"{self.url}/sample",
                data=fields,
                files={"image": ("scenario.png", image_png, "image/png")},
                headers={"Accept": f"{NPY}, application/problem+json"},
            )
        except httpx.TimeoutException as error:
            raise SamplerUnavailableError(
                f"the sampling endpoint {self.url} did not answer in time",
                expected=f"an answer within {self._http.timeout.read} s",
                got=type(error).__name__,
                remedy=_START_REMEDY,
            ) from error
        except (httpx.HTTPError, httpx.StreamError) as error:
            raise SamplerUnavailableError(
                f"the sampling endpoint {self.url} can not be reached",
                got=str(error) or type(error).__name__,
                remedy=_START_REMEDY,
            ) from error


def _checked(url: str) -> str:
    try:
        parsed = httpx.URL(url)
    except (httpx.InvalidURL, TypeError) as error:
        raise _bad_url(url) from error
    if parsed.scheme not in ("http", "https") or not parsed.host or parsed.query or parsed.fragment:
        raise _bad_url(url)
    return url.rstrip("/")


def _bad_url(url: str) -> ConfigError:
    return ConfigError(
        "the sampling endpoint's address can not be",
        expected="http://host:port",
        got=repr(url),
        remedy="for example http://127.0.0.1:8000",
    )


def _refusal(answer: httpx.Response) -> SamplerError:
    """The error that an answer other than 200 stands for, with the problem's own words (RFC 9457)."""
    problem = _problem(answer)
    kind = SamplerUnavailableError if answer.status_code == httpx.codes.SERVICE_UNAVAILABLE else SamplerError
    title = problem.get("title") or f"{answer.status_code} {answer.reason_phrase}".strip()
    named = f" ({problem['type']})" if problem.get("type") else ""
    got = problem.get("detail") or f"status {answer.status_code}"
    return kind(f"the sampling endpoint refused the request: {title}{named}", got=got)


def _problem(answer: httpx.Response) -> dict[str, str]:
    if "json" not in answer.headers.get("content-type", ""):
        return {}
    try:
        members = answer.json()
    except (ValueError, RecursionError):
        return {}
    if not isinstance(members, dict):
        return {}
    return {name: value for name, value in members.items() if isinstance(value, str)}
