"""Which bundle answers which reference: the champion in service, others on demand, the shipped one else.

The background follows the registry (:meth:`ModelStore.refresh`), so that a promotion is served without a
restart and no request for the champion waits for the registry. A champion that is refused, or a registry that
is away, leaves the one in service. With no champion at all the shipped bundle answers if it is of the same
robot, and the answer says so.
"""

import logging
import time
from collections.abc import AsyncIterator, Callable, MutableMapping, Sequence
from concurrent.futures import Future, wait
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from functools import partial
from threading import Event, Lock, Thread
from typing import Literal, TypeVar

from anyio import to_thread
from cachetools import LRUCache, TTLCache

from cspace.bundle import Bundle
from cspace.errors import (
    BundleError,
    GoldenMismatchError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
    StorageError,
)
from inference_api.models.cache import RETRY_S, BundleCache, key_of
from inference_api.models.pictures import PictureCache
from inference_api.models.planner import PlannerStart
from inference_api.models.served import ServedModel, ShippedModels
from inference_api.models.worker import RegistryWorker
from inference_api.problem_types import ModelNotReadyError
from services.names import (
    ALIAS_CHAMPION,
    SCENE_MODEL_NAME,
    TAG_ROBOT,
)
from services.registry.entities import PRETRAINED, ModelReader, ModelReference, ModelVersion, is_model_name
from services.registry.errors import anonymous

_Answer = TypeVar("_Answer")
# Why a champion is not put into service: its bundle is damaged or not the registered one, its golden case
# gives other answers here, the registry is away, or the cache cannot be written.
Refusal = Literal["bundle", "golden", "registry", "storage"]
_LOG = logging.getLogger(__name__)
LOAD_WAIT_S = 30.0
# For how long after a request named it a reference is looked up in the background.
IN_USE_S = 60.0
# References that are remembered, and as many that are known to name nothing.
REMEMBERED = 1024
LISTED_MODELS = 100


@dataclass(slots=True)
class _Known:
    """What a reference stands for, until when that is trusted, and when a request named it last; s.

    It is overtaken while the version that took its place is being loaded.
    """

    version: ModelVersion
    until_s: float
    used_s: float
    overtaken: bool = False


@dataclass(slots=True, eq=False)
class _Successor:
    """The champion that is to follow the one in service; once it has failed, when it is tried again, s."""

    version: ModelVersion
    future: "Future[Bundle]"
    retry_s: float | None = None


class ModelStore:
    """Bundles by reference; safe to share between threads.

    Args:
        registry: None serves the shipped models only.
        cache: of downloaded bundles.
        shipped: the models that come with the server.
        model_name: whose champion is the default.
        lookup_s: how long a lookup is trusted, and how long an absent registry is left alone.
        clock: seconds, monotonic.
        pictures: those that were encoded already; none are kept when None.
        wait_s: how long :meth:`resolve` waits for a bundle, at most.
    """

    def __init__(
        self,
        registry: ModelReader | None,
        cache: BundleCache,
        shipped: ShippedModels,
        model_name: str,
        lookup_s: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
        pictures: PictureCache | None = None,
        wait_s: float = LOAD_WAIT_S,
    ) -> None:
        # Told of each champion that was put into service, or of the reason why it was not.
        self.on_champion: Callable[[Refusal | None], None] = lambda _: None
        self.planner = PlannerStart()
        self.pictures = PictureCache(0) if pictures is None else pictures
        self.model_name, self.shipped = model_name, shipped
        self._registry, self._cache = registry, cache
        self._lookup_s, self._clock, self._wait_s = lookup_s, clock, wait_s
        self._known: MutableMapping[ModelReference, _Known] = LRUCache(REMEMBERED)
        self._unknown: MutableMapping[ModelReference, bool] = TTLCache(REMEMBERED, lookup_s, clock)
        self._listed: MutableMapping[str, Sequence[ModelVersion]] = TTLCache(1, lookup_s, clock)
        # With the time until which it is trusted, s.
        self._away_until: float | None = None
        self._champion: ServedModel | None = None
        # Of the last champion; None where it is not known.
        last = cache.disk.last_champion(model_name)
        self._robot = None if last is None else last.tags.get(TAG_ROBOT)
        self._stand_in: ServedModel | None = None
        self._successor: _Successor | None = None
        self._lock, self._settling = Lock(), Lock()

    @property
    def registry_state(self) -> Literal["none", "reachable", "unreachable"]:
        """Whether the registry answered when it was asked last."""
        if self._registry is None:
            return "none"
        return "reachable" if self._away_until is None else "unreachable"

    @property
    def successor(self) -> Literal["none", "pending", "refused"]:
        """Whether there is a champion that is not in service: it is being fetched, or could not follow."""
        successor = self._successor
        if successor is None:
            return "none"
        return "pending" if successor.retry_s is None else "refused"

    @property
    def default(self) -> ServedModel | None:
        """The model that answers requests that name none, None without one."""
        found = self._champion or self._stand_in
        return found if found is None else self._as_confirmed(found)

    def load_shipped(self) -> None:
        """Load what is shipped; without a usable bundle the reason is logged and the store goes on."""
        self.shipped.look()
        self._stand_in = self.shipped.stand_in(self.model_name, self._robot)

    def start(self) -> None:
        """Start the registry's worker process, without waiting for it."""
        if isinstance(self._registry, RegistryWorker):
            self._registry.start()

    def close(self) -> None:
        """End the worker process: whoever waits for it gets an error at once."""
        if isinstance(self._registry, RegistryWorker):
            self._registry.close()

    def refresh(self, wait_s: float = LOAD_WAIT_S) -> None:
        """Look up the champion and what requests named lately; the project's errors are not raised.

        Args:
            wait_s: for what has to be loaded, at most; it comes into service when it is there, waited for
                or not.
        """
        if self._registry is None:
            return
        until_s = time.monotonic() + wait_s
        successor = self._follow_champion()
        others = self._follow_known()
        wait([future for _, _, future in others], wait_s)
        for known, version, future in others:
            # Once more here and below: whoever waits is woken before the callbacks have run.
            if future.done():
                self._trust(known, version)
        if successor is not None:
            wait([successor.future], max(0.0, until_s - time.monotonic()))
            self._settle(successor)

    def resolve_now(self, reference: ModelReference) -> ServedModel | None:
        """The model that a reference names, from memory alone; None when :meth:`resolve` has to be asked.

        Raises:
            ModelNotFoundError: there is no such model, or there was none a moment ago.
            ModelNotReadyError: no model answers by default.
        """
        if reference.name in self.shipped:
            if not reference.is_bare:
                raise _unknown(reference)
            if not self.shipped.is_usable(reference.name):
                raise self._not_ready()
            return self.shipped.peek(reference.name)
        if reference == ModelReference(self.model_name):
            default = self.default
            if default is None:
                raise self._not_ready()
            return default
        champion = self._champion
        if champion is not None and reference == ModelReference(self.model_name, ALIAS_CHAMPION):
            return self._as_confirmed(champion)
        try:
            version = self._recall(reference)
        except ModelNotFoundError:
            return self.shipped.peek(self._instead_of(reference), fallback=True)
        bundle = None if version is None else self._cache.peek(version)
        return None if version is None or bundle is None else self._found(bundle, version, reference)

    def resolve(self, reference: ModelReference) -> ServedModel:
        """The model that a reference names; may ask the registry and wait for a bundle.

        Raises:
            ModelNotFoundError: there is no such model.
            RegistryError: the registry is needed and does not answer.
            StorageError: the cache cannot be written.
            ModelNotReadyError: the model cannot be served, or is still being fetched.
        """
        found = self.resolve_now(reference)
        if found is not None:
            return found
        if reference.name in self.shipped:
            return self.shipped.get(reference.name)
        until_s = time.monotonic() + self._wait_s
        try:
            version = self._look_up(reference)
        except ModelNotFoundError:
            return self.shipped.get(self._instead_of(reference), fallback=True)
        try:
            bundle = self._cache.start(version).result(max(0.0, until_s - time.monotonic()))
        except TimeoutError:
            raise ModelNotReadyError(
                f"{version} is still being fetched", remedy="ask again in some seconds"
            ) from None
        except BundleError as error:
            raise ModelNotReadyError(
                f"{version} is refused", expected="a sound bundle", got=anonymous(str(error))
            ) from error
        return self._found(bundle, version, reference)

    def versions(self, name: str) -> Sequence[ModelVersion]:
        """Versions of a model, newest first; those of the cache while the registry is away."""
        if self._registry is None:
            return []
        try:
            self._leave_alone_while_away()
            found = list(self._ask(partial(self._registry.versions, name)))
            if any(version.name != name for version in found):
                raise _another(ModelReference(name))
        except ModelNotFoundError:
            return []
        except RegistryError:
            found = self._cache.disk.stored(name)
        return sorted(found, key=lambda version: version.number, reverse=True)

    def listed(self) -> Sequence[ModelVersion]:
        """All versions of the default model, then those of others that an alias names, newest first.

        Of the first :data:`LISTED_MODELS` models by name; those of the cache while the registry is away.
        Remembered as long as a lookup is trusted, for it asks about each of them.
        """
        if self._registry is None:
            return []
        with self._lock:
            remembered = self._listed.get(self.model_name)
        if remembered is not None:
            return remembered
        try:
            self._leave_alone_while_away()
            names = self._ask(self._registry.names)
        except RegistryError:
            names = tuple(self._cache.disk.names())
        fitting = [
            name for name in names if is_model_name(name) and name not in (self.model_name, SCENE_MODEL_NAME)
        ]
        others = [version for name in fitting[:LISTED_MODELS] for version in self.versions(name)]
        found = [*self.versions(self.model_name), *(version for version in others if version.aliases)]
        with self._lock:
            self._listed[self.model_name] = found
        return found

    def loaded(self, version: ModelVersion) -> Bundle | None:
        """A version's bundle if it is in memory; looking at it is no use of it."""
        champion = self._champion
        if champion is not None and self._is_champion(version):
            return champion.bundle
        return self._cache.peek(version, use=False)

    # What references stand for.

    def _recall(self, reference: ModelReference) -> ModelVersion | None:
        """The version that a reference names, from memory alone; None when that does not know.

        Raises:
            ModelNotFoundError: there was no such version a moment ago.
        """
        with self._lock:
            is_unknown = self._registry is None or reference in self._unknown
            known = self._known.get(reference)
            if known is not None:
                known.used_s = self._clock()
                return known.version if known.used_s < known.until_s else None
        if is_unknown:
            raise _unknown(reference)
        return None

    def _look_up(self, reference: ModelReference) -> ModelVersion:
        """The version that a reference names; the last known one while the registry is away.

        Raises:
            ModelNotFoundError: there is no such version.
            RegistryError: the registry does not answer and nothing is known.
        """
        requested_s = self._clock()
        recalled = self._recall(reference)
        if recalled is not None:
            return recalled
        try:
            self._leave_alone_while_away()
            found = self._find(reference)
        except ModelNotFoundError:
            self._forget(reference)
            raise
        except RegistryError:
            with self._lock:
                known = self._known.get(reference)
            stored = [
                one for one in self._cache.disk.stored(reference.name) if one.number == reference.version
            ]
            if known is None and not stored:
                raise
            return stored[-1] if known is None else known.version
        with self._lock:
            self._known[reference] = _Known(found, self._clock() + self._lookup_s, requested_s)
        return found

    def _follow_known(self) -> list[tuple[_Known, ModelVersion, "Future[Bundle]"]]:
        """Look up what requests named lately, and load what took its place, so that no request waits.

        What this finds is trusted for twice as long as there is between two looks. Until a successor is
        loaded its predecessor answers. What cannot be loaded is an error of the request that names it.
        """
        now_s = self._clock()
        with self._lock:
            lately = [item for item in self._known.items() if now_s - item[1].used_s < IN_USE_S]
        successors = []
        for reference, known in lately:
            try:
                self._leave_alone_while_away()
                found = self._find(reference)
            except ModelNotFoundError:
                self._forget(reference)
                continue
            except RegistryError:
                break
            if key_of(found) == key_of(known.version):
                self._trust(known, found)
                continue
            self._trust(known, known.version, overtaken=True)
            future = self._cache.start(found)
            future.add_done_callback(partial(self._arrived, known, found))
            successors.append((known, found, future))
        return successors

    def _find(self, reference: ModelReference) -> ModelVersion:
        if self._registry is None:
            raise _unknown(reference)
        found = self._ask(partial(reference.look_up, self._registry))
        # Its name becomes a folder's, and it is what the answer to a request says.
        if found.name != reference.name or reference.version not in (None, found.number):
            raise _another(reference)
        return found

    def _trust(self, known: _Known, version: ModelVersion, *, overtaken: bool = False) -> None:
        with self._lock:
            known.version, known.until_s = version, self._clock() + 2.0 * self._lookup_s
            known.overtaken = overtaken

    def _arrived(self, known: _Known, version: ModelVersion, _: "Future[Bundle]") -> None:
        self._trust(known, version)

    def _forget(self, reference: ModelReference) -> None:
        with self._lock:
            self._known.pop(reference, None)
            self._unknown[reference] = True

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

    def _found(self, bundle: Bundle, version: ModelVersion, reference: ModelReference) -> ServedModel:
        # Confirmed where the registry, asked last, says so; a number never moves.
        with self._lock:
            known = self._known.get(reference)
        is_known = known is not None and not known.overtaken and key_of(known.version) == key_of(version)
        confirmed = reference.version is not None or (is_known and self._away_until is None)
        alias = ALIAS_CHAMPION if reference.is_bare else reference.alias
        return ServedModel.of(bundle, version, alias, confirmed=confirmed)

    # The champion.

    def _follow_champion(self) -> _Successor | None:
        """Have a champion fetched that is not in service; None without one, or where it failed just now."""
        try:
            version: ModelVersion | None = self._find(ModelReference(self.model_name, ALIAS_CHAMPION))
        except ModelNotFoundError:
            version = None
        except RegistryError:
            if self._champion is not None:
                return None
            version = self._cache.disk.last_champion(self.model_name)
        with self._lock:
            if version is None:
                self._champion = None
            if version is None or self._is_champion(version):
                self._successor = None
                return None
            successor = self._successor
            is_same = successor is not None and key_of(successor.version) == key_of(version)
            if successor is not None and is_same and successor.retry_s is not None:
                if self._clock() < successor.retry_s:
                    return None
                is_same = False
            if successor is None or not is_same:
                successor = _Successor(version, self._cache.start(version, first=True))
                self._successor = successor
        # Not within the lock, for what is there already is settled at once.
        successor.future.add_done_callback(lambda _: self._settle(successor))
        return successor

    def _settle(self, successor: _Successor) -> None:
        """Put a successor into service that has arrived, once; whoever comes second waits for the first."""
        with self._settling:
            if self._successor is not successor or successor.retry_s is not None:
                return
            if not successor.future.done():
                return
            version, error = successor.version, successor.future.exception()
            if error is not None:
                successor.retry_s = self._clock() + RETRY_S
                self.on_champion(_refusal_of(error))
                _LOG.warning("what is in service stays, %s cannot follow: %s", version, anonymous(str(error)))
                return
            bundle = successor.future.result()
            with self._lock:
                self._champion, self._robot = ServedModel.of(bundle, version, ALIAS_CHAMPION), bundle.robot
                self._successor = None
            self._stand_in = self.shipped.stand_in(self.model_name, self._robot)
            self.on_champion(None)
            _LOG.info("in service: %s", version)
            try:
                self._cache.disk.remember_champion(version)
            except StorageError as storage_error:
                _LOG.warning("the champion will not be remembered over a restart: %s", storage_error)

    def _as_confirmed(self, served: ServedModel) -> ServedModel:
        """The champion or what stands in for it, and whether the registry says that it is that."""
        is_confirmed = self.registry_state != "unreachable" and self.successor == "none"
        return served if is_confirmed else replace(served, confirmed=False)

    def _is_champion(self, version: ModelVersion) -> bool:
        current = self._champion
        known = (version.number, version.digest)
        return current is not None and (current.version, current.bundle.digest) == known

    # The shipped models in place of others.

    def _instead_of(self, reference: ModelReference) -> str:
        """The shipped model of the robot of a model that has no champion.

        Raises:
            ModelNotFoundError: there is none.
        """
        name = self.shipped.named_after(reference.name) if reference.is_bare else None
        if name is None:
            raise _unknown(reference)
        return name

    def _not_ready(self) -> ModelNotReadyError:
        other = "; the shipped model is of another robot" if self.shipped.is_usable(PRETRAINED) else ""
        return ModelNotReadyError(
            "no model is ready",
            expected=f"a champion of {self.model_name}, or a shipped model",
            got=f"none (registry: {self.registry_state}){other}",
            remedy="train and promote a model, or ask again when the registry is back",
        )


@asynccontextmanager
async def following(store: ModelStore, poll_s: float, first_s: float) -> AsyncIterator[None]:
    """A store whose models are loaded, and which follows its registry until this is left.

    Args:
        store: with nothing loaded yet.
        poll_s: between two looks at the registry.
        first_s: for the first look, without which the shipped model would answer for a champion.
    """
    ended, looked = Event(), Event()

    def poll() -> None:
        wait_s = first_s
        while not ended.is_set():
            try:
                store.refresh(wait_s)
            except Exception:  # noqa: BLE001 - a loop that has ended would never serve another promotion
                _LOG.exception("looking the champion up failed")
            looked.set()
            wait_s = poll_s
            ended.wait(poll_s)

    try:
        # First, for the registry and the shipped model then take their time together.
        store.start()
        # A daemon, for a look may wait and nobody waits for it.
        Thread(target=poll, name="poll", daemon=True).start()
        await to_thread.run_sync(store.load_shipped)
        await to_thread.run_sync(looked.wait, first_s, abandon_on_cancel=True)
        yield
    finally:
        ended.set()
        store.close()


def _refusal_of(error: BaseException) -> Refusal:
    if isinstance(error, RegistryError):
        return "registry"
    if isinstance(error, StorageError):
        return "storage"
    return "golden" if isinstance(error, GoldenMismatchError) else "bundle"


def _unknown(reference: ModelReference) -> ModelNotFoundError:
    return ModelNotFoundError(
        "the model is unknown",
        expected="a model, version or alias of the registry, or pretrained",
        got=str(reference),
        remedy="GET /models lists the models",
    )


def _another(reference: ModelReference) -> RegistryError:
    return RegistryError(
        "the model registry answers with another model than it was asked for", expected=str(reference)
    )
