"""The registry as the API sees it: looked up rarely, left alone while away, the cache in its place."""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import TypeVar

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError, RegistryError, RegistryUnavailableError
from inference_api.models.apart.remembered import Remembered
from inference_api.models.bundle_cache import BundleCache, key_of
from services.names import ALIAS_CHAMPION
from services.registry.models.port import ModelLookups, ModelVersion
from services.registry.references import ModelReference

_Answer = TypeVar("_Answer")
_LOG = logging.getLogger(__name__)
# For how long after a request named it a reference is looked up in the background.
IN_USE_S = 60.0
# References that are remembered, and as many that are known to name nothing.
REMEMBERED = 1024
LOAD_WAIT_S = 30.0


@dataclass(slots=True)
class _Known:
    """What a reference stood for, until when that is trusted, and when a request named it last; seconds.

    It is overtaken while the version that took its place is being loaded.
    """

    version: ModelVersion
    until_s: float
    used_s: float
    overtaken: bool = False


class RegistryView:
    """Lookups with a short memory; safe to share between threads.

    Args:
        registry: the real one, or a fake.
        cache: of downloaded bundles; it also answers while the registry is away.
        lookup_s: how long an answer is trusted, and how long an absent registry is left alone.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        registry: ModelLookups,
        cache: BundleCache,
        lookup_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._registry = registry
        self._cache = cache
        self._lookup_s = lookup_s
        self._clock = clock
        self._known: OrderedDict[ModelReference, _Known] = OrderedDict()
        self._unknown: Remembered[ModelReference, ModelNotFoundError] = Remembered(REMEMBERED, clock)
        self._away_until: float | None = None
        self._lock = Lock()

    @property
    def is_away(self) -> bool:
        """Whether the registry did not answer when it was asked last."""
        return self._away_until is not None

    def champion(self, name: str) -> ModelVersion | None:
        """The version that holds the champion's alias, asked for now; None when there is none.

        Raises:
            RegistryError: the registry does not answer.
        """
        try:
            return self._ask(lambda: self._find(ModelReference(name, ALIAS_CHAMPION)))
        except ModelNotFoundError:
            return None

    def recall(self, reference: ModelReference) -> ModelVersion | None:
        """The version that a reference names, from memory alone; None when that does not know.

        Raises:
            ModelNotFoundError: there was no such version a moment ago.
        """
        known = self._use(reference)
        if known is not None:
            return known.version if self._clock() < known.until_s else None
        missing = self._unknown.get(reference)
        if missing is not None:
            raise ModelNotFoundError(missing.what, expected=missing.expected, got=missing.got)
        return None

    def confirms(self, reference: ModelReference, version: ModelVersion) -> bool:
        """Whether a version is what the registry, asked last, said of its reference; a number never moves."""
        with self._lock:
            known = self._known.get(reference)
        told = known is not None and not known.overtaken and key_of(known.version) == key_of(version)
        return reference.version is not None or (told and not self.is_away)

    def look_up(self, reference: ModelReference) -> ModelVersion:
        """The version that a reference names; the last known one while the registry is away.

        Raises:
            ModelNotFoundError: there is no such version.
            RegistryError: the registry does not answer and nothing is known.
        """
        asked_s = self._clock()
        recalled = self.recall(reference)
        if recalled is not None:
            return recalled
        try:
            self._leave_alone_while_away()
            found = self._ask(lambda: self._find(reference))
        except ModelNotFoundError as error:
            self._forget(reference, error)
            raise
        except RegistryError:
            known = self._use(reference)
            stored = self._stored(reference) if known is None else known.version
            if stored is None:
                raise
            return stored
        with self._lock:
            self._known[reference] = _Known(found, self._clock() + self._lookup_s, asked_s)
            self._known.move_to_end(reference)
            while len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        return found

    def keep_up(self, wait_s: float = LOAD_WAIT_S) -> None:
        """Look up again what requests named lately, and load what took its place, so that no request waits.

        To be called every ``lookup_s``; what it finds is trusted for twice as long, to outlast the next call.
        Until a successor is loaded its predecessor answers. What cannot be loaded is told to the request that
        names it.

        Args:
            wait_s: for the successors, at most; they come into use when they are there, waited for or not.
        """
        now_s = self._clock()
        with self._lock:
            lately = [
                (named, known) for named, known in self._known.items() if now_s - known.used_s < IN_USE_S
            ]
        successors: list[tuple[_Known, ModelVersion, Future[Bundle]]] = []
        for reference, known in lately:
            try:
                self._leave_alone_while_away()
                found = self._ask(partial(self._find, reference))
            except ModelNotFoundError as error:
                self._forget(reference, error)
                continue
            except RegistryError:
                break
            if (found.number, found.digest) == (known.version.number, known.version.digest):
                self._trust(known, found)
                continue
            self._trust(known, known.version, overtaken=True)
            future = self._cache.start(found)
            future.add_done_callback(partial(self._follow, known, found))
            successors.append((known, found, future))
        done, _ = wait([future for _, _, future in successors], wait_s)
        for known, found, future in successors:
            # Once more: whoever waits is woken before the callbacks have run.
            if future in done:
                self._trust(known, found)

    def versions(self, name: str) -> Sequence[ModelVersion]:
        """Versions of a model, newest first; those of the cache while the registry is away."""
        try:
            self._leave_alone_while_away()
            found = self._ask(lambda: self._list(name))
        except ModelNotFoundError:
            return []
        except RegistryError:
            found = self._cache.disk.stored(name)
        return sorted(found, key=lambda version: version.number, reverse=True)

    def _list(self, name: str) -> list[ModelVersion]:
        found = list(self._registry.versions(name))
        if any(version.name != name for version in found):
            raise _another(ModelReference(name))
        return found

    def _find(self, reference: ModelReference) -> ModelVersion:
        found = reference.look_up(self._registry)
        # Its name becomes a folder's, and it is what the answer to a request says.
        if found.name != reference.name or reference.version not in (None, found.number):
            raise _another(reference)
        return found

    def _use(self, reference: ModelReference) -> _Known | None:
        with self._lock:
            known = self._known.get(reference)
            if known is not None:
                known.used_s = self._clock()
                self._known.move_to_end(reference)
            return known

    def _trust(self, known: _Known, version: ModelVersion, *, overtaken: bool = False) -> None:
        with self._lock:
            known.version, known.until_s = version, self._clock() + 2.0 * self._lookup_s
            known.overtaken = overtaken

    def _follow(self, known: _Known, version: ModelVersion, _: Future[Bundle]) -> None:
        self._trust(known, version)

    def _forget(self, reference: ModelReference, error: ModelNotFoundError) -> None:
        with self._lock:
            self._known.pop(reference, None)
        self._unknown.put(reference, error, self._lookup_s)

    def _stored(self, reference: ModelReference) -> ModelVersion | None:
        stored = [
            item for item in self._cache.disk.stored(reference.name) if item.number == reference.version
        ]
        return stored[-1] if stored else None

    def _ask(self, question: Callable[[], _Answer]) -> _Answer:
        try:
            answer = question()
        except ModelNotFoundError:
            self._away_until = None
            raise
        except RegistryError as error:
            if self._away_until is None:
                _LOG.warning("the registry does not answer; what is loaded stays in service: %s", error)
            self._away_until = self._clock() + self._lookup_s
            raise
        self._away_until = None
        return answer

    def _leave_alone_while_away(self) -> None:
        """Requests must not queue up behind time-outs."""
        away_until = self._away_until
        if away_until is not None and self._clock() < away_until:
            raise RegistryUnavailableError(
                "the model registry does not answer", remedy="ask again in some seconds"
            )


def _another(reference: ModelReference) -> RegistryError:
    return RegistryError(
        "the model registry answers with another model than it was asked for", expected=str(reference)
    )
