"""The registry as the API sees it: looked up rarely, left alone while away, the cache in its place."""

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import TypeVar

from cspace.bundle import Bundle
from cspace.errors import CspaceError, ModelNotFoundError, RegistryError, RegistryUnavailableError
from inference_api.bundle_cache import BundleCache
from inference_api.references import CHAMPION, ModelReference
from services.registry.models import ModelRegistry, ModelVersion

_Answer = TypeVar("_Answer")
_LOG = logging.getLogger(__name__)
# For how long after a request named it a reference is looked up in the background.
IN_USE_S = 60.0


@dataclass(slots=True)
class _Known:
    """What a reference stood for, until when that is trusted, and when a request named it last; seconds."""

    version: ModelVersion
    until_s: float
    used_s: float


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
        registry: ModelRegistry,
        cache: BundleCache,
        lookup_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._registry = registry
        self._cache = cache
        self._lookup_s = lookup_s
        self._clock = clock
        self._known: dict[ModelReference, _Known] = {}
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
            return self._ask(lambda: self._registry.by_alias(name, CHAMPION))
        except ModelNotFoundError:
            return None

    def look_up(self, reference: ModelReference) -> ModelVersion:
        """The version that a reference names; the last known one while the registry is away.

        Raises:
            ModelNotFoundError: there is no such version.
            RegistryError: the registry does not answer and nothing is known.
        """
        asked_s = self._clock()
        with self._lock:
            known = self._known.get(reference)
            if known is not None:
                known.used_s = asked_s
        if known is not None and asked_s < known.until_s:
            return known.version
        try:
            self._leave_alone_while_away()
            found = self._ask(lambda: self._find(reference))
        except ModelNotFoundError:
            with self._lock:
                self._known.pop(reference, None)
            raise
        except RegistryError:
            stored = self._stored(reference) if known is None else known.version
            if stored is None:
                raise
            return stored
        with self._lock:
            self._known[reference] = _Known(found, self._clock() + self._lookup_s, asked_s)
        return found

    def keep_up(self) -> None:
        """Look up again what requests named lately, and load what took its place, so that no request waits.

        To be called every ``lookup_s``; what it finds is trusted for twice as long, to outlast the next call.
        What cannot be loaded is told to the request that names it.
        """
        now_s = self._clock()
        with self._lock:
            lately = [
                (named, known) for named, known in self._known.items() if now_s - known.used_s < IN_USE_S
            ]
        for reference, known in lately:
            try:
                self._leave_alone_while_away()
                found = self._ask(partial(self._find, reference))
            except ModelNotFoundError:
                with self._lock:
                    self._known.pop(reference, None)
                continue
            except RegistryError:
                return
            if (found.number, found.digest) != (known.version.number, known.version.digest):
                with suppress(CspaceError):
                    self.bundle(found)
            with self._lock:
                known.version, known.until_s = found, self._clock() + 2.0 * self._lookup_s

    def versions(self, name: str) -> Sequence[ModelVersion]:
        """Versions of a model, newest first; those of the cache while the registry is away."""
        try:
            self._leave_alone_while_away()
            found = self._ask(lambda: list(self._registry.versions(name)))
        except ModelNotFoundError:
            return []
        except RegistryError:
            found = self._cache.stored(name)
        return sorted(found, key=lambda version: version.number, reverse=True)

    def bundle(self, version: ModelVersion) -> Bundle:
        """The bundle of a version, as :meth:`BundleCache.get`."""
        return self._cache.get(version, self._registry)

    def _find(self, reference: ModelReference) -> ModelVersion:
        if reference.version is not None:
            return self._registry.version(reference.name, reference.version)
        return self._registry.by_alias(reference.name, reference.alias or CHAMPION)

    def _stored(self, reference: ModelReference) -> ModelVersion | None:
        stored = [item for item in self._cache.stored(reference.name) if item.number == reference.version]
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
