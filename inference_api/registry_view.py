"""The registry as the API sees it: looked up rarely, left alone while away, the cache in its place."""

import logging
import time
from collections.abc import Callable, Sequence
from threading import Lock
from typing import TypeVar

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError, RegistryError, RegistryUnavailableError
from inference_api.bundle_cache import BundleCache
from inference_api.references import CHAMPION, ModelReference
from services.registry.models import ModelRegistry, ModelVersion

_Answer = TypeVar("_Answer")
_LOG = logging.getLogger(__name__)


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
        self._known: dict[ModelReference, tuple[float, ModelVersion]] = {}
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
        with self._lock:
            expires, known = self._known.get(reference, (0.0, None))
        if known is not None and self._clock() < expires:
            return known
        try:
            self._leave_alone_while_away()
            found = self._ask(lambda: self._find(reference))
        except ModelNotFoundError:
            with self._lock:
                self._known.pop(reference, None)
            raise
        except RegistryError:
            stored = known or self._stored(reference)
            if stored is None:
                raise
            return stored
        with self._lock:
            self._known[reference] = (self._clock() + self._lookup_s, found)
        return found

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
