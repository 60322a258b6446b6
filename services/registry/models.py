"""Registered models on an MLflow server.

A version belongs to one of MLflow's logged models, which ties it to its run and, through the run's inputs, to
the data. ``mlflow-skinny`` is enough.
"""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlsplit

from mlflow import MlflowClient
from mlflow.artifacts import download_artifacts
from mlflow.entities import LoggedModel, LoggedModelOutput, LoggedModelStatus, Metric, Run
from mlflow.entities.model_registry import ModelVersion as MlflowVersion

from cspace.bundle import BundleSpec
from cspace.bundle.files import SPEC_FILE, read_files
from cspace.errors import BundleIntegrityError, ModelNotFoundError, RegistryError, StorageError
from services.names import ALIAS_CHAMPION, ARTIFACT_STORE, TAG_DIGEST, world_tags
from services.registry.entities import ModelReference, ModelVersion
from services.registry.errors import check_reachable, mapped, without_user_info
from services.registry.tracking import MAX_BATCH, MAX_DIGEST, all_pages, ignored

# Where the bundle lies inside the saved model.
BUNDLE_PATH = "artifacts/bundle"
# A redirect and a presigned address lead wherever the answering server likes. MLflow reads these from the
# environment only; whoever needs them sets them.
_FOLLOW_NOTHING = {"MLFLOW_ALLOW_HTTP_REDIRECTS": "false", "MLFLOW_ENABLE_PROXY_MULTIPART_DOWNLOAD": "false"}


class ModelRegistry:
    """Where bundles become versions. What names a version that is not there raises ModelNotFoundError."""

    def __init__(self, uri: str, *, timeout_s: float = 3.0, artifact_store: str = "") -> None:
        """Bundles are fetched from the tracking server, and from below ``artifact_store`` if that is set."""
        for name, value in _FOLLOW_NOTHING.items():
            os.environ.setdefault(name, value)
        with mapped("opening the registry"):
            self._client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self._uri, self._timeout_s = uri, timeout_s
        self._artifact_store = artifact_store or os.environ.get(ARTIFACT_STORE, "")

    def register(
        self,
        name: str,
        bundle_folder: Path,
        run_id: str,
        digest: str,
        tags: Mapping[str, str],
        *,
        alias: str | None = None,
    ) -> ModelVersion:
        """Make a bundle of a run the next version of a model, which is created when it is new.

        The same digest from the same run is registered once: a second call returns the first version, with
        the tags and the alias set again. :func:`services.names.world_tags` are added.
        """
        files = read_files(bundle_folder)
        if files.digest != digest:
            expected, got = f"digest {digest}", files.digest
            raise BundleIntegrityError("another bundle is to be registered", expected=expected, got=got)
        spec = BundleSpec.from_json(files.contents[SPEC_FILE])
        all_tags = {**tags, **world_tags(spec.world), TAG_DIGEST: digest}

        with self._asking(f"registering {name} for run {run_id}"):
            run = self._client.get_run(run_id)
            if not (made := self._made(name, run_id, digest)):
                model = _logged_model(self._client, name, bundle_folder, run, all_tags)
                with ignored("RESOURCE_ALREADY_EXISTS"):
                    self._client.create_registered_model(name)
                # The UI links a version to its logged model by the short form that only a server resolves.
                is_server = self._client.tracking_uri.startswith("http")
                source = f"models:/{model.model_id}" if is_server else str(model.artifact_location)
                self._client.create_model_version(
                    name, source, run_id=run_id, tags=all_tags, await_creation_for=0, model_id=model.model_id
                )
                made = self._made(name, run_id, digest)
            # A call that MLflow's client repeated may have made two.
            first, *repeated = made
            for number in repeated:
                self._client.delete_model_version(name, str(number))
        self.set_tags(name, first, all_tags)
        if alias is not None:
            self.set_alias(name, alias, first)
        return self.version(name, first)

    def _made(self, name: str, run_id: str, digest: str) -> list[int]:
        found = self._client.search_model_versions(f"name='{name}' AND run_id='{run_id}'")
        return sorted(int(one.version) for one in found if one.tags.get(TAG_DIGEST) == digest)

    def look_up(self, reference: ModelReference) -> ModelVersion:
        """The version that is meant."""
        if reference.version is not None:
            return self.version(reference.name, reference.version)
        return self.by_alias(reference.name, reference.alias or ALIAS_CHAMPION)

    def version(self, name: str, number: int) -> ModelVersion:
        """One version by its number."""
        with self._asking(f"looking up {name}/{number}", lookup=True):
            return _version(self._client.get_model_version(name, str(number)))

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        """The version that an alias points to."""
        with self._asking(f"looking up {name}@{alias}", lookup=True):
            return _version(self._client.get_model_version_by_alias(name, alias))

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """All versions, newest first; empty for an unknown model."""
        with self._asking(f"listing the versions of {name}"):
            found = all_pages(self._client.search_model_versions, f"name='{name}'")
            # MLflow's search for versions leaves the aliases out.
            aliases = self._client.get_registered_model(name).aliases if found else {}
        complete = [
            replace(one, aliases=tuple(sorted(a for a in aliases if int(aliases[a]) == one.number)))
            for one in map(_version, found)
        ]
        return tuple(sorted(complete, key=lambda one: one.number, reverse=True))

    def names(self) -> tuple[str, ...]:
        """The registered models, in alphabetical order."""
        with self._asking("listing the models"):
            found = all_pages(self._client.search_registered_models)
            return tuple(sorted(model.name for model in found))

    def delete(self, name: str, number: int) -> None:
        """Delete a version for good; its number is not given again."""
        with self._asking(f"deleting {name}/{number}", lookup=True):
            self._client.delete_model_version(name, str(number))

    def set_alias(self, name: str, alias: str, number: int) -> None:
        """Point an alias to a version, away from whichever had it."""
        with self._asking(f"pointing {name}@{alias} to {number}", lookup=True):
            self._client.set_registered_model_alias(name, alias, str(number))

    def set_tags(self, name: str, number: int, tags: Mapping[str, str]) -> None:
        """Set tags on a version; others stay."""
        with self._asking(f"setting tags on {name}/{number}", lookup=True):
            for key, value in tags.items():
                self._client.set_model_version_tag(name, str(number), key, value)

    def remove_tag(self, name: str, number: int, tag: str) -> None:
        """Take a tag off a version; nothing happens where it has none of this name."""
        with self._asking(f"taking a tag off {name}/{number}", lookup=True):
            self._client.delete_model_version_tag(name, str(number), tag)

    def show(
        self, version: ModelVersion, metrics: Mapping[str, float], note: str, data: str, data_digest: str
    ) -> None:
        """Show metrics and a note in Markdown of a version, on its run and logged model too.

        They replace earlier ones; ``data`` names what was evaluated on.
        """
        with self._asking(f"showing figures of {version}", lookup=True):
            self._client.update_model_version(version.name, str(version.number), note)
        with mapped(f"showing figures of {version}"):
            run = self._client.get_run(version.run_id)
            model = next(_whole_models(self._client, version.name, run, version.digest), None)
            model_id = None if model is None else model.model_id
            digest, now_ms = data_digest[:MAX_DIGEST], time.time_ns() // 1_000_000
            points = [
                Metric(key, value, now_ms, 0, model_id, data, digest, version.run_id)
                for key, value in metrics.items()
            ]
            self._client.log_batch(version.run_id, points)

    def download(self, version: ModelVersion, folder: Path) -> Path:
        """Fetch a version's bundle into a new folder, whole or not at all; returns the folder."""
        if folder.exists():
            raise StorageError("the download's folder exists", expected="a new folder", got=str(folder))
        with self._asking(f"looking up {version}", lookup=True):
            source = self._client.get_model_version_download_uri(version.name, str(version.number))
        check_source(str(version), source, self._uri, self._artifact_store)
        with mapped(f"downloading {version}"):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as beside:
                address = f"{source}/{BUNDLE_PATH}"
                got = Path(download_artifacts(address, dst_path=beside, tracking_uri=self._uri))
                if not got.is_dir() or not any(got.iterdir()):
                    raise ModelNotFoundError(f"{version} holds no bundle", expected=BUNDLE_PATH)
                got.rename(folder)
        return folder

    @contextmanager
    def _asking(self, action: str, *, lookup: bool = False) -> Iterator[None]:
        """As :func:`mapped`; a server that is away is found out first, within this registry's timeout."""
        check_reachable(self._uri, self._timeout_s)
        with mapped(action, lookup=lookup):
            yield


def check_source(label: str, source: str, tracking_uri: str, artifact_store: str = "") -> None:
    """Refuse to fetch a version from anywhere but the artifact store.

    The registry names the place, and who may write to the registry names any: a file of this machine, or
    another server.
    """
    found, server, store = urlsplit(source), urlsplit(tracking_uri), artifact_store.rstrip("/")
    if server.scheme in ("http", "https"):
        own = ("", server.netloc, server.netloc.rpartition("@")[2])
        is_known = found.scheme == "mlflow-artifacts" and found.netloc in own
    else:
        is_known = found.scheme in ("", "file") and not found.netloc
    is_known = is_known or (bool(store) and source.startswith(f"{store}/"))
    # Further servers on the way may decode once more.
    decoded = unquote(source)
    if not is_known or "%" in decoded or ".." in decoded.replace("\\", "/").split("/"):
        raise RegistryError(
            f"{label} does not lie in the artifact store",
            expected="mlflow-artifacts of the tracking server" + (f", or {store}/..." if store else ""),
            got=without_user_info(source)[:200],
            remedy=f"set {ARTIFACT_STORE} to the store's address if it is yours",
        )


def _version(found: MlflowVersion) -> ModelVersion:
    tags = dict(found.tags)
    return ModelVersion(
        name=found.name,
        number=int(found.version),
        run_id=found.run_id or "",
        digest=tags.get(TAG_DIGEST, ""),
        aliases=tuple(sorted(found.aliases)),
        tags=tags,
        created_ms=int(found.creation_timestamp),
    )


def _whole_models(client: MlflowClient, name: str, run: Run, digest: str) -> Iterator[LoggedModel]:
    """Logged models of a run and a digest; those that an interrupted attempt left half are deleted."""
    query = f"source_run_id = '{run.info.run_id}' AND name = '{name}'"
    for model in client.search_logged_models([run.info.experiment_id], query):
        if model.tags.get(TAG_DIGEST) != digest:
            continue
        if model.status == LoggedModelStatus.READY:
            yield model
        else:
            client.delete_logged_model(model.model_id)


def _logged_model(
    client: MlflowClient, name: str, bundle_folder: Path, run: Run, tags: Mapping[str, str]
) -> LoggedModel:
    """A bundle as a logged model of its run; one that an interrupted attempt has finished is taken over."""
    whole = list(_whole_models(client, name, run, tags[TAG_DIGEST]))
    if whole:
        return whole[0]
    info = run.info
    model = client.create_logged_model(
        info.experiment_id, name, info.run_id, dict(tags), run.data.params, "sampler"
    )
    status = LoggedModelStatus.FAILED
    try:
        with tempfile.TemporaryDirectory(prefix="cspace-model-") as folder:
            shutil.copytree(bundle_folder, Path(folder) / BUNDLE_PATH)
            client.log_model_artifacts(model.model_id, folder)
        client.log_outputs(info.run_id, [LoggedModelOutput(model.model_id, step=0)])
        _carry_metrics(client, run, model.model_id)
        status = LoggedModelStatus.READY
    finally:
        client.finalize_logged_model(model.model_id, status)
    return model


def _carry_metrics(client: MlflowClient, run: Run, model_id: str) -> None:
    """Show the run's last metrics and its data set on the logged model too.

    The run itself does not change: MLflow drops points that equal one that is there.
    """
    run_id, used = run.info.run_id, run.inputs.dataset_inputs if run.inputs else []
    name, digest = (used[0].dataset.name, used[0].dataset.digest) if used else (None, None)
    points = []
    for key in run.data.metrics:
        history = client.get_metric_history(run_id, key)
        last = max(history, key=lambda point: (point.step, point.timestamp))
        points.append(Metric(key, last.value, last.timestamp, last.step, model_id, name, digest, run_id))
    for first in range(0, len(points), MAX_BATCH):
        client.log_batch(run_id, metrics=points[first : first + MAX_BATCH])
