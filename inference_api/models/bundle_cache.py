"""Bundles in memory by version, and how a version gets there: downloaded, verified apart, then opened here.

A version is loaded once however many ask for it. What has to be downloaded waits in another lane than what
is on disk, so that a slow registry does not delay the latter. What could not be loaded is not tried again
at once, for whoever names it could keep a lane busy with it.
"""

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from threading import Lock

from cspace.bundle import Bundle
from cspace.errors import BundleError, CspaceError, RegistryError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.lanes import Lane
from inference_api.models.apart.loading import BundleLoader, NotVerifiedError
from inference_api.models.apart.remembered import Remembered
from services.registry.models.port import ModelVersion

# A bundle that was refused is tried again, but not for every request, and less and less often: equal sums are
# equal bytes, and each try may take a core for as long as a verification may.
RETRY_S, LONGEST_RETRY_S = 15.0, 900.0
# As what failed for another reason, which may be over soon.
SOON_S = 2.0
# A version may vanish between two steps, while other processes prune the cache.
ATTEMPTS = 5
_REMEMBERED = 1024
Key = tuple[str, int, str]


class NotLoadedYetError(CspaceError):
    """The bundle is on its way."""


class _DamagedError(Exception):
    """The copy on disk is damaged, and not there any more."""

    def __init__(self, error: BundleError) -> None:
        super().__init__(str(error))
        self.error = error


class BundleCache:
    """Bundles by version; safe to share between threads.

    Args:
        disk: where downloaded versions are.
        loader: downloads and verifies.
        capacity: bundles kept in memory, the least recently used dropped first.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        disk: DiskCache,
        loader: BundleLoader,
        capacity: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.disk = disk
        self._loader = loader
        self._capacity = capacity
        self._loaded: OrderedDict[Key, Bundle] = OrderedDict()
        self._pending: dict[Key, Future[Bundle]] = {}
        self._refusals: Remembered[Key, int] = Remembered(_REMEMBERED, clock)
        self._failed: Remembered[Key, CspaceError] = Remembered(_REMEMBERED, clock)
        # By digest: equal sums are equal bytes, so what was verified once need not be again.
        self._verified: Remembered[str, str] = Remembered(_REMEMBERED, clock)
        self._lock = Lock()
        self._near_lane, self._far_lane = Lane("near"), Lane("far")

    def peek(self, version: ModelVersion, *, use: bool = True) -> Bundle | None:
        """The version's bundle if it is in memory, and whether this is a use of it."""
        key = key_of(version)
        with self._lock:
            if use and key in self._loaded:
                self._loaded.move_to_end(key)
            return self._loaded.get(key)

    def start(self, version: ModelVersion, *, first: bool = False) -> Future[Bundle]:
        """The version's bundle, now or later: this waits for nothing.

        Args:
            version: which.
            first: before all others that wait.

        Returns:
            What raises BundleError for a bundle that is refused, RegistryError for one that cannot be
            downloaded, StorageError for a cache that cannot be written, and NotLoadedYetError if too many
            wait already.
        """
        key = key_of(version)
        bundle, failed = self.peek(version), self._failed.get(key)
        if bundle is not None or failed is not None:
            return _done(bundle, failed)
        with self._lock:
            if key in self._pending:
                return self._pending[key]
            future = self._pending[key] = Future[Bundle]()
        try:
            is_near = self.disk.holds(version)
        except (CspaceError, OSError):
            # The lane comes by the same error and tells it.
            is_near = True
        lane, load = (self._near_lane, self._load_near) if is_near else (self._far_lane, self._load_far)
        if not lane.put(partial(self._settle, version, future, load), first=first):
            too_many = NotLoadedYetError(
                "too many models are being fetched", remedy="ask again in some seconds"
            )
            self._finish(key, future, None, too_many)
        return future

    def get(self, version: ModelVersion, wait_s: float) -> Bundle:
        """The version's bundle, waited for.

        Args:
            version: which.
            wait_s: for how long, at most.

        Raises:
            NotLoadedYetError: it takes longer.
            CspaceError: as :meth:`start` has it.
        """
        try:
            return self.start(version).result(wait_s)
        except TimeoutError:
            raise NotLoadedYetError(
                f"{version} is still being fetched", remedy="ask again in some seconds"
            ) from None

    def _settle(
        self,
        version: ModelVersion,
        future: Future[Bundle],
        load: Callable[[ModelVersion], Bundle],
    ) -> None:
        bundle, error = None, None
        try:
            bundle = load(version)
        except _DamagedError as damaged:
            again = partial(self._load_anew, damaged.error)
            self._far_lane.put(partial(self._settle, version, future, again), first=True)
            return
        except CspaceError as caught:
            error = caught
        except Exception as caught:  # noqa: BLE001 - whoever waits has to be told, and the lane goes on
            error = NotVerifiedError("a model could not be loaded", got=type(caught).__name__)
        self._finish(key_of(version), future, bundle, error)

    def _finish(
        self, key: Key, future: Future[Bundle], bundle: Bundle | None, error: CspaceError | None
    ) -> None:
        if isinstance(error, BundleError):
            times = self._refusals.get(key) or 0
            self._refusals.put(key, times + 1, math.inf)
            self._failed.put(key, error, min(RETRY_S * 2.0**times, LONGEST_RETRY_S))
        elif error is not None and not isinstance(error, NotLoadedYetError):
            self._failed.put(key, error, SOON_S)
        with self._lock:
            self._pending.pop(key, None)
            if bundle is not None:
                self._loaded[key] = bundle
                while len(self._loaded) > self._capacity:
                    self._loaded.popitem(last=False)
        if bundle is not None:
            future.set_result(bundle)
        else:
            future.set_exception(error)

    def _load_near(self, version: ModelVersion) -> Bundle:
        try:
            return self._open(version)
        except BundleError as error:
            # Raises for a version that cannot be in the cache at all.
            self.disk.remove(version)
            raise _DamagedError(error) from None

    def _load_anew(self, damage: BundleError, version: ModelVersion) -> Bundle:
        try:
            return self._load_far(version)
        except RegistryError:
            # What was wrong with the copy says more than that there is no other.
            raise damage from None

    def _load_far(self, version: ModelVersion) -> Bundle:
        for attempt in range(ATTEMPTS):
            self._loader.download(version)
            try:
                return self._open(version)
            except BundleError:
                has_vanished = not self.disk.holds(version)
                if not has_vanished:
                    self.disk.remove(version)
                if not has_vanished or attempt == ATTEMPTS - 1:
                    raise
        raise AssertionError("unreachable")

    def _open(self, version: ModelVersion) -> Bundle:
        if self._verified.get(version.digest) is None:
            self._loader.verify(version)
        bundle = Bundle.load(self.disk.bundle(version), digest=version.digest, check=False)
        self._verified.put(version.digest, version.name, math.inf)
        self.disk.touch(version)
        return bundle


def key_of(version: ModelVersion) -> Key:
    """What tells versions apart, also those of a registry that was set up anew."""
    return version.name, version.number, version.digest


def _done(bundle: Bundle | None, error: CspaceError | None) -> Future[Bundle]:
    future: Future[Bundle] = Future()
    if bundle is not None:
        future.set_result(bundle)
    else:
        future.set_exception(error)
    return future
