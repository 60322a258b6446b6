"""The champion that is to follow the one in service: fetched while others answer, left alone once refused."""

import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from threading import Lock
from typing import Literal

from cspace.bundle import Bundle
from cspace.errors import GoldenMismatchError, RegistryError, StorageError
from inference_api.models.bundle_cache import RETRY_S, BundleCache, key_of
from inference_api.telemetry.observer import Refusal
from services.registry.models.port import ModelVersion


@dataclass(frozen=True, slots=True, eq=False)
class Fetch:
    """A champion on its way."""

    version: ModelVersion
    future: Future[Bundle]


class Succession:
    """At most one successor at a time; safe to share between threads.

    Args:
        cache: where it is loaded.
        succeeded: told the bundle of a successor that has arrived.
        failed: told why one has not; both are called once, one at a time.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        cache: BundleCache,
        succeeded: Callable[[ModelVersion, Bundle], None],
        failed: Callable[[ModelVersion, BaseException], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._cache, self._clock = cache, clock
        self._succeeded, self._failed = succeeded, failed
        self._fetch: Fetch | None = None
        # By digest, and until when it is left alone.
        self._refused: tuple[str, float] = ("", 0.0)
        self._lock = Lock()

    @property
    def state(self) -> Literal["none", "pending", "refused"]:
        """Whether there is a successor that is not in service: on its way, or refused lately."""
        if self._fetch is not None:
            return "pending"
        return "refused" if self._refused[0] else "none"

    def none(self) -> None:
        """There is no successor: what is in service is right, or nothing is."""
        with self._lock:
            self._fetch, self._refused = None, ("", 0.0)

    def fetch(self, version: ModelVersion) -> Fetch | None:
        """Have a successor fetched, before all else; None for one that was refused a moment ago."""
        with self._lock:
            digest, until_s = self._refused
            if digest == version.digest and self._clock() < until_s:
                return None
            if self._fetch is None or key_of(self._fetch.version) != key_of(version):
                self._fetch = Fetch(version, self._cache.start(version, first=True))
            fetch = self._fetch
        # Not within the lock, for what is there already is settled at once.
        fetch.future.add_done_callback(lambda _: self._settle(fetch))
        return fetch

    def wait_for(self, fetch: Fetch, wait_s: float) -> None:
        """Return when a fetch has ended and was told about, or after so long."""
        wait([fetch.future], wait_s)
        # Whoever waits is woken before the callbacks have run.
        self._settle(fetch)

    def _settle(self, fetch: Fetch) -> None:
        with self._lock:
            if self._fetch is not fetch or not fetch.future.done():
                return
            self._fetch = None
            error = fetch.future.exception()
            if error is None:
                self._refused = ("", 0.0)
                self._succeeded(fetch.version, fetch.future.result())
            else:
                self._refused = (fetch.version.digest, self._clock() + RETRY_S)
                self._failed(fetch.version, error)


def refusal_of(error: BaseException) -> Refusal:
    """Why a successor has not come into service, in the words of the metrics."""
    if isinstance(error, RegistryError):
        return "registry"
    if isinstance(error, StorageError):
        return "storage"
    return "golden" if isinstance(error, GoldenMismatchError) else "bundle"
