"""Models that answer: versions of the registry, and those that ship with the server.

One thread polls the registry for the champion. A promotion is thus served without a restart, and no request
waits for it. A champion that is refused, or a registry that is away, leaves the one in service. With no
champion at all the shipped model of the same robot answers, and says so. What other references stand for is
asked when a request names them, at most once in a poll.
"""

import logging
import math
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Lock
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from anyio import CapacityLimiter, to_thread
from cachetools import LRUCache, TTLCache
from fastapi import Depends, Request
from pydantic import TypeAdapter, ValidationError

from cspace.bundle import Bundle, BundleSpec
from cspace.bundle.files import SPEC_FILE, read_files
from cspace.errors import (
    BundleError,
    BundleIntegrityError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
    ServiceError,
    StorageError,
)
from cspace.files import read_bounded, replacing
from cspace.worlds import robot_digest
from inference_api.problems import ModelNotReadyError
from inference_api.settings import ApiSettings
from services.names import (
    ALIAS_CHAMPION,
    SCENE_MODEL_NAME,
    TAG_ROBOT,
    TAG_SIGNATURE,
    may_name,
    model_name,
    recorded_name,
)
from services.registry.entities import PRETRAINED, ModelReference, ModelVersion, is_model_name
from services.registry.errors import anonymous
from services.registry.signing import require_signature

if TYPE_CHECKING:
    from services.registry.models import ModelRegistry

_Answer = TypeVar("_Answer")
# What became of a champion; the log says why one is refused.
Reload = Literal["served", "refused", "removed"]
PRETRAINED_VERSION = 0
# A request waits so long while another one loads a version.
LOAD_WAIT_S = 30.0
# A refused bundle is not looked at again for so long: equal sums are equal bytes.
REFUSED_S = 300.0
REMEMBERED, LISTED_MODELS, LOOKUPS = 1024, 100, 16
MAX_DESCRIPTION_BYTES = 2**20
_CHAMPION, _TEMPORARY, _LEFT_OVER_S = "champion.json", ".download-", 3600.0
_DESCRIPTION = TypeAdapter(ModelVersion)
_LOG = logging.getLogger(__name__)
_Key = tuple[str, int, str, str]


def _key_of(version: ModelVersion) -> _Key:
    """What tells versions apart, also those of a registry that was set up again, or signed by now."""
    return version.name, version.number, version.digest, version.tags.get(TAG_SIGNATURE, "")


@dataclass(frozen=True, slots=True)
class ServedModel:
    """A loaded bundle with the name under which it answers; ``version`` is 0 for a shipped model."""

    bundle: Bundle
    name: str
    version: int
    alias: str | None = None
    run_id: str | None = None
    # Whether a shipped model stands in for a champion.
    fallback: bool = False
    # Whether the registry, asked last, says that the alias stands for this version.
    confirmed: bool = True

    def __str__(self) -> str:
        return f"{self.name}/{self.version}"


@dataclass(frozen=True, slots=True)
class Shipped:
    """A shipped model; ``loaded`` is None before it was asked for."""

    name: str
    spec: BundleSpec
    digest: str
    loaded: ServedModel | None

    def fits(self, model: str, robot: str | None) -> bool:
        """Whether it may stand in for a registered model of a robot; without its digest the name decides."""
        world, given = self.spec.world, recorded_name(self.spec.provenance.config)
        if robot is not None:
            return robot == robot_digest(world)
        return may_name(model, world, given) if self.name == PRETRAINED else model == model_name(world, given)


class ShippedModels:
    """The first in memory from the start, others when first asked for; safe to share between threads."""

    def __init__(self, folders: Mapping[str, Path]) -> None:
        self._folders, self._lock = dict(folders), Lock()
        self._found: dict[str, Shipped] = {}

    def __iter__(self) -> Iterator[Shipped]:
        return iter(list(self._found.values()))

    def __contains__(self, name: str) -> bool:
        return name in self._folders

    def look(self) -> None:
        """Load the first, and read the descriptions of the others; what is not usable is logged."""
        for name, folder in self._folders.items():
            try:
                if name == PRETRAINED:
                    self.get(name)
                else:
                    files = read_files(folder)
                    spec = BundleSpec.from_json(files.contents[SPEC_FILE])
                    self._found.setdefault(name, Shipped(name, spec, files.digest, None))
            except (BundleError, ModelNotReadyError) as error:
                _LOG.warning("the shipped model %s is not usable: %s", name, error)

    def peek(self, name: str) -> ServedModel | None:
        """A model that is in memory."""
        found = self._found.get(name)
        return None if found is None else found.loaded

    def get(self, name: str) -> ServedModel:
        """The same, loaded now where it was not."""
        # One at a time: two requests at once would have the memory of two.
        with self._lock:
            found = self.peek(name)
            if found is None:
                try:
                    # It comes with the program, or the operator chose it: its graphs are trusted.
                    bundle = Bundle.load(self._folders[name], check=False)
                except BundleError as error:
                    what = f"the shipped model {name} cannot be served"
                    raise ModelNotReadyError(what, expected="a sound bundle", got=error.what) from error
                found = ServedModel(bundle, name, PRETRAINED_VERSION)
                self._found[name] = Shipped(name, bundle.spec, bundle.digest, found)
            return found

    def stand_in(self, model: str, robot: str | None, *, but: str = "") -> str | None:
        """The name of the first that may stand in for a registered model, if any."""
        return next((one.name for one in self if one.name != but and one.fits(model, robot)), None)


class BundleFolders:
    """Downloaded bundles, each in ``<folder>/<name>/<number>-<digest>/``; processes may share the folder.

    ``stored`` versions of each model are kept beside its last champion, at least 1.
    """

    def __init__(self, folder: Path, stored: int) -> None:
        self._folder, self._stored = folder, stored

    def place(self, version: ModelVersion) -> Path:
        """Where a version's bundle is, or would be."""
        if re.fullmatch("[0-9a-f]{64}", version.digest) is None:
            raise BundleIntegrityError(
                f"{version} was registered without a digest", got=repr(version.digest)[:100]
            )
        # A registry that was set up again counts its versions from 1.
        return self._folder / version.name / f"{version.number}-{version.digest[:16]}"

    def fetch(self, version: ModelVersion, download: Callable[[ModelVersion, Path], Path]) -> Path:
        """The folder of a version's bundle, downloaded where it is not there."""
        place = self.place(version)
        try:
            if not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                with tempfile.TemporaryDirectory(prefix=_TEMPORARY, dir=place.parent) as temporary:
                    whole = download(version, Path(temporary) / "bundle")
                    _stamp(whole)
                    try:
                        whole.rename(place)
                    except OSError:
                        # Unless another process was first.
                        if not place.exists():
                            raise
                self._prune(version, place)
            _stamp(place)
        except OSError as error:
            remedy = "free some space, or set CSPACE_MODEL_CACHE to another folder"
            got = error.strerror or type(error).__name__
            raise StorageError("the model cache cannot be written", got=got, remedy=remedy) from None
        return place

    def remove(self, version: ModelVersion) -> None:
        """Take a version away."""
        _delete(self.place(version))

    def last_champion(self, name: str) -> ModelVersion | None:
        """The champion of a model when the registry was last there; None for a file that is damaged."""
        try:
            data = read_bounded(self._folder / name / _CHAMPION, MAX_DESCRIPTION_BYTES, StorageError)
            version = _DESCRIPTION.validate_json(data)
        except (StorageError, ValidationError):
            return None
        return version if version.name == name else None

    def remember_champion(self, version: ModelVersion) -> None:
        """Keep a version as the last known champion of its model."""
        try:
            with replacing(self._folder / version.name / _CHAMPION) as beside:
                beside.write_bytes(_DESCRIPTION.dump_json(version))
        except OSError as error:
            _LOG.warning("the champion will not be remembered over a restart: %s", error.strerror)

    def _prune(self, version: ModelVersion, newest: Path) -> None:
        """Deletes the versions used least recently, and what processes have left that died in between."""
        champion = self.last_champion(version.name)
        safe = {newest} if champion is None else {newest, self.place(champion)}
        with suppress(OSError):
            used = {path: path.stat().st_mtime for path in newest.parent.iterdir() if path.is_dir()}
            left = {path for path in used if path.name.startswith(_TEMPORARY)}
            versions = sorted(used.keys() - left, key=used.__getitem__, reverse=True)
            for path in (*versions[self._stored :], *left):
                if path not in safe and (path not in left or time.time() - used[path] > _LEFT_OVER_S):
                    _delete(path)


def _stamp(place: Path) -> None:
    """Note that a folder is used now; the kernel's own stamps are up to 4 ms old."""
    now_ns = time.time_ns()
    os.utime(place, ns=(now_ns, now_ns))


def _delete(place: Path) -> None:
    """By a rename first, so that what is read is there whole or not at all."""
    with suppress(OSError):
        gone = Path(tempfile.mkdtemp(prefix=_TEMPORARY, dir=place.parent))
        with suppress(FileNotFoundError):
            place.rename(gone / place.name)
        shutil.rmtree(gone, ignore_errors=True)


class ModelStore:
    """Bundles by reference; safe to share between threads.

    ``registry`` opens it when it is first asked; None serves the shipped models only. ``verify`` takes a
    bundle's folder and digest, and raises BundleError, or ServiceError where nobody could look at it.
    """

    def __init__(
        self,
        settings: ApiSettings,
        registry: "Callable[[], ModelRegistry] | None",
        verify: Callable[[Path, str], object],
    ) -> None:
        # Told of each champion that was put into service, refused or removed.
        self.on_reload: Callable[[Reload], None] = lambda _: None
        self.shipped = ShippedModels(settings.shipped_folders)
        self.model_name, self._poll_s = settings.model_name, settings.model_poll_s
        self._registry, self._verify, self._trusted_key = registry, verify, settings.trusted_key
        self._disk = BundleFolders(settings.model_cache, settings.stored_models)
        self._bundles: MutableMapping[_Key, Bundle] = LRUCache(settings.loaded_models)
        # What references stood for, if anything, and when the registry was asked, s.
        self._known: MutableMapping[ModelReference, tuple[ModelVersion | None, float]] = LRUCache(REMEMBERED)
        self._refused: MutableMapping[_Key, BundleError] = TTLCache(REMEMBERED, REFUSED_S)
        self._listed: MutableMapping[str, list[ModelVersion]] = TTLCache(1, self._poll_s)
        self._lock, self._loading, self._lookups = Lock(), Lock(), CapacityLimiter(LOOKUPS)
        self._champion: ServedModel | None = None
        self._stand_in: ServedModel | None = None
        # Whether there is a champion that is not in service: it is being fetched, or could not follow.
        self.successor: Literal["none", "pending", "refused"] = "none"
        self._refused_champion: _Key | None = None
        self._away_until: float | None = None
        self.ended = Event()

    @property
    def registry_state(self) -> Literal["none", "reachable", "unreachable"]:
        """Whether the registry answered when it was asked last."""
        if self._registry is None:
            return "none"
        return "reachable" if self._away_until is None else "unreachable"

    @property
    def default(self) -> ServedModel | None:
        """The model that answers requests that name none, None without one."""
        found = self._champion or self._stand_in
        confirmed = self.registry_state != "unreachable" and self.successor == "none"
        return found if found is None or confirmed else replace(found, confirmed=False)

    def listing(self, name: str | None = None) -> Sequence[ModelVersion]:
        """Versions of a model, newest first; none while the registry is away.

        Without a name all of the default model, then those of others that an alias names.
        """
        if name is not None:
            return self._versions(name)
        with self._lock:
            found = self._listed.get(self.model_name)
        if found is None:
            names: Sequence[str] = ()
            with suppress(RegistryError):
                names = self._ask(lambda registry: registry.names())
            found = self._versions(self.model_name)
            others = [one for one in names if one not in (self.model_name, SCENE_MODEL_NAME)]
            for other in [one for one in others if is_model_name(one)][:LISTED_MODELS]:
                found += [version for version in self._versions(other) if version.aliases]
            with self._lock:
                self._listed[self.model_name] = found
        return found

    def _versions(self, name: str) -> list[ModelVersion]:
        try:
            found = self._ask(lambda registry: registry.versions(name))
        except RegistryError:
            return []
        return sorted((one for one in found if one.name == name), key=lambda one: one.number, reverse=True)

    def loaded(self, version: ModelVersion) -> Bundle | None:
        """A version's bundle if it is in memory."""
        champion = self._champion
        if champion is not None and self._is_champion(version):
            return champion.bundle
        with self._lock:
            return self._bundles.get(_key_of(version))

    async def resolve(self, reference: ModelReference) -> ServedModel:
        """As :meth:`get`, off the event loop where it has to wait."""
        found = self.peek(reference)
        if found is not None:
            return found
        return await to_thread.run_sync(self.get, reference, limiter=self._lookups)

    def peek(self, reference: ModelReference) -> ServedModel | None:
        """The model that a reference names, from memory alone; None when :meth:`get` has to be asked."""
        if reference.name in self.shipped:
            if not reference.is_bare:
                raise _unknown(reference)
            return self.shipped.peek(reference.name)
        if reference == ModelReference(self.model_name):
            default = self.default
            if default is None:
                expected = f"a champion of {self.model_name}, or a shipped model of its robot"
                got = f"none (registry: {self.registry_state})"
                remedy = "train and promote a model, or ask again when the registry is back"
                raise ModelNotReadyError("no model is ready", expected=expected, got=got, remedy=remedy)
            return default
        if self._champion is not None and reference == ModelReference(self.model_name, ALIAS_CHAMPION):
            return self.default
        if self._registry is None:
            return self._instead(reference, self.shipped.peek)
        with self._lock:
            version, asked_s = self._known.get(reference, (None, -math.inf))
            bundle = None if version is None else self._bundles.get(_key_of(version))
        found = None
        if time.monotonic() - asked_s < self._poll_s:
            if version is None:
                found = self._instead(reference, self.shipped.peek)
            elif bundle is not None:
                found = self._served(bundle, reference, version)
        return found

    def get(self, reference: ModelReference) -> ServedModel:
        """The model that a reference names; may ask the registry and load a bundle."""
        found = self.peek(reference)
        if found is not None:
            return found
        if reference.name in self.shipped:
            return self.shipped.get(reference.name)
        if self._registry is None and (found := self._instead(reference, self.shipped.get)) is not None:
            return found
        try:
            version = self._know(reference)
        except ModelNotFoundError:
            found = self._instead(reference, self.shipped.get)
            if found is None:
                raise
            return found
        return self._served(self._loaded(version), reference, version)

    def _served(self, bundle: Bundle, reference: ModelReference, version: ModelVersion) -> ServedModel:
        # A number never moves.
        confirmed = reference.version is not None or self._away_until is None
        alias = ALIAS_CHAMPION if reference.is_bare else reference.alias
        return ServedModel(
            bundle, version.name, version.number, alias, version.run_id or None, confirmed=confirmed
        )

    def _instead(
        self, reference: ModelReference, find: Callable[[str], ServedModel | None]
    ) -> ServedModel | None:
        """The shipped model of the robot of a model that has no champion."""
        name = self.shipped.stand_in(reference.name, None, but=PRETRAINED) if reference.is_bare else None
        if name is None:
            raise _unknown(reference)
        found = find(name)
        return None if found is None else replace(found, fallback=True)

    def load_shipped(self) -> None:
        """Load what is shipped; without a usable bundle the reason is logged and the store goes on."""
        self.shipped.look()
        last = self._disk.last_champion(self.model_name)
        self._choose_stand_in(None if last is None else last.tags.get(TAG_ROBOT))

    def _choose_stand_in(self, robot: str | None) -> None:
        name, self._stand_in = self.shipped.stand_in(self.model_name, robot), None
        with suppress(ModelNotReadyError):
            self._stand_in = None if name is None else replace(self.shipped.get(name), fallback=True)

    def follow(self, looked: Event) -> None:
        """Look the registry up until ``ended`` is set; ``looked`` is set after the first time."""
        while not self.ended.is_set():
            try:
                self.refresh()
            except Exception:  # noqa: BLE001 - a loop that has ended would never serve another promotion
                _LOG.exception("looking the champion up failed")
            looked.set()
            self.ended.wait(self._poll_s)

    def refresh(self) -> None:
        """Look up the champion, and load it where it is new."""
        if self._registry is None:
            return
        try:
            version: ModelVersion | None = self._look_up(ModelReference(self.model_name, ALIAS_CHAMPION))
        except ModelNotFoundError:
            version = None
            if self._champion is not None:
                _LOG.warning("%s is no champion any more; a shipped model answers", self._champion)
                self._champion = None
                self.on_reload("removed")
        except RegistryError:
            if self._champion is not None:
                return
            version = self._disk.last_champion(self.model_name)
        if version is None or self._is_champion(version):
            self.successor = "none"
            return
        is_refused = self._refused_champion == _key_of(version)
        if not is_refused:
            self.successor = "pending"
        try:
            bundle = self._load(version)
        except (RegistryError, BundleError, StorageError) as error:
            self.successor = "refused"
            # Once as long as that stays so.
            if not is_refused:
                self._refused_champion = _key_of(version)
                reason = anonymous(str(error))
                _LOG.warning("what is in service stays, %s cannot follow: %s", version, reason)
                self.on_reload("refused")
            return
        self._champion = ServedModel(
            bundle, version.name, version.number, ALIAS_CHAMPION, version.run_id or None
        )
        self.successor, self._refused_champion = "none", None
        self._choose_stand_in(bundle.robot)
        _LOG.info("in service: %s", version)
        self.on_reload("served")
        self._disk.remember_champion(version)

    def _is_champion(self, version: ModelVersion) -> bool:
        champion, known = self._champion, (version.number, version.digest)
        return champion is not None and (champion.version, champion.bundle.digest) == known

    def _know(self, reference: ModelReference) -> ModelVersion:
        """What a reference stands for; the last known version while the registry is away."""
        try:
            version = self._look_up(reference)
        except ModelNotFoundError:
            with self._lock:
                self._known[reference] = None, time.monotonic()
            raise
        except RegistryError:
            with self._lock:
                known, _ = self._known.get(reference, (None, 0.0))
            if known is None:
                raise
            version = known
        with self._lock:
            self._known[reference] = version, time.monotonic()
        return version

    def _look_up(self, reference: ModelReference) -> ModelVersion:
        found = self._ask(lambda registry: registry.look_up(reference))
        # Its name becomes a folder's, and it is what the answer to a request says.
        if found.name != reference.name or reference.version not in (None, found.number):
            raise RegistryError(
                "the model registry answers with another model than it was asked for", expected=str(reference)
            )
        return found

    def _ask(self, question: "Callable[[ModelRegistry], _Answer]") -> _Answer:
        """The registry's answer; one that is away is left alone, or requests would queue up behind it."""
        away_until = self._away_until
        if self._registry is None or (away_until is not None and time.monotonic() < away_until):
            raise RegistryUnavailableError(
                "the model registry does not answer", remedy="ask again in some seconds"
            )
        try:
            answer = question(self._registry())
        except ModelNotFoundError:
            self._away_until = None
            raise
        except RegistryError as error:
            if away_until is None:
                _LOG.warning("the registry does not answer; what is loaded stays: %s", anonymous(str(error)))
            self._away_until = time.monotonic() + 0.9 * self._poll_s
            raise
        self._away_until = None
        return answer

    def _loaded(self, version: ModelVersion) -> Bundle:
        """A version's bundle for a request; one is loaded at a time, beside the champion."""
        with self._lock:
            bundle = self._bundles.get(_key_of(version))
        if bundle is not None:
            return bundle
        if not self._loading.acquire(timeout=LOAD_WAIT_S):
            raise ModelNotReadyError("other models are being loaded", remedy="ask again in some seconds")
        try:
            return self._load(version)
        except BundleError as error:
            raise ModelNotReadyError(
                f"{version} is refused", expected="a sound bundle", got=anonymous(str(error))
            ) from error
        finally:
            self._loading.release()

    def _load(self, version: ModelVersion) -> Bundle:
        """A version's bundle: downloaded where it is not on disk, verified, opened."""
        key = _key_of(version)
        with self._lock:
            bundle, refused = self._bundles.get(key), self._refused.get(key)
        if refused is not None:
            raise refused
        if bundle is not None:
            return bundle
        try:
            was_there = self._disk.place(version).exists()
            try:
                bundle = self._checked(version)
            except BundleError:
                self._disk.remove(version)
                if not was_there:
                    raise
                # What was damaged may have been the copy.
                bundle = self._checked(version)
        except BundleError as error:
            with self._lock:
                self._refused[key] = error
            raise
        with self._lock:
            self._bundles[key] = bundle
        return bundle

    def _checked(self, version: ModelVersion) -> Bundle:
        folder = self._disk.fetch(version, self._download)
        try:
            self._verify(folder, version.digest)
            if self._trusted_key is not None:
                require_signature(folder, version, self._trusted_key)
        except ServiceError as error:
            raise RegistryUnavailableError(f"{version} cannot be verified", got=error.got) from None
        return Bundle.load(folder, digest=version.digest, check=False, replay=False)

    def _download(self, version: ModelVersion, folder: Path) -> Path:
        if self._registry is None:
            raise RegistryUnavailableError(f"there is no registry that has {version}")
        return self._registry().download(version, folder)


def _unknown(reference: ModelReference) -> ModelNotFoundError:
    return ModelNotFoundError(
        "the model is unknown",
        expected="a model, version or alias of the registry, or pretrained",
        got=str(reference),
        remedy="GET /models lists the models",
    )


async def _models_of(request: Request) -> ModelStore:
    models: ModelStore = request.app.state.models
    return models


# What routes take.
Models = Annotated[ModelStore, Depends(_models_of)]
