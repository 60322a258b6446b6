"""The model registry on an MLflow server.

Looking up and downloading work with ``mlflow-skinny`` alone; registering needs the whole of MLflow. A version
belongs to one of MLflow's logged models, which ties it to its run and, through the run's inputs, to the data.
"""

import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlsplit

from mlflow import MlflowClient
from mlflow.artifacts import download_artifacts
from mlflow.entities import Metric
from mlflow.entities.model_registry import ModelVersion as MlflowVersion

from cspace.errors import ModelNotFoundError, RegistryError, StorageError
from services.names import ARTIFACT_STORE, TAG_DIGEST, world_tags
from services.registry.mlflow_errors import mapped
from services.registry.mlflow_health import check_reachable
from services.registry.models.mlflow_model import BUNDLE_PATH, read_spec
from services.registry.models.mlflow_registering import create_version, logged_model
from services.registry.models.port import ModelVersion, Shown
from services.registry.scrubbing import without_user_info

_PAGE = 100
# Of a data set's digest, which MLflow keeps no more of.
MAX_DIGEST = 36
# A redirect and a presigned address lead wherever the answering server likes. MLflow reads these from the
# environment only; whoever needs them sets them.
_FOLLOW_NOTHING = {"MLFLOW_ALLOW_HTTP_REDIRECTS": "false", "MLFLOW_ENABLE_PROXY_MULTIPART_DOWNLOAD": "false"}


class MlflowRegistry:
    """The port :class:`services.registry.models.port.ModelRegistry` on MLflow.

    Args:
        uri: of the tracking server, or ``sqlite:///…`` where the whole of mlflow is installed.
        patience_s: how long the server may take to show that it is there, before each operation.
        artifact_store: address below which bundles are fetched beside the tracking server's own artifacts;
            ``CSPACE_ARTIFACT_STORE`` when empty.
    """

    def __init__(self, uri: str, *, patience_s: float = 3.0, artifact_store: str = "") -> None:
        for name, value in _FOLLOW_NOTHING.items():
            os.environ.setdefault(name, value)
        with mapped("opening the registry"):
            self._client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self._uri = uri
        self._artifact_store = artifact_store or os.environ.get(ARTIFACT_STORE, "")
        self._patience_s = patience_s

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
        """Make a bundle a version; see :meth:`services.registry.models.port.ModelRegistry.register`."""
        spec = read_spec(bundle_folder, digest)
        all_tags = {**tags, **world_tags(spec.world), TAG_DIGEST: digest}
        self._ready()
        found = [one for one in self.versions(name) if (one.run_id, one.digest) == (run_id, digest)]
        if found:
            number = found[-1].number
            self.set_tags(name, number, all_tags)
        else:
            number = create_version(self._client, name, bundle_folder, spec, run_id, all_tags)
        if alias is not None:
            self.set_alias(name, alias, number)
        return self.version(name, number)

    def version(self, name: str, number: int) -> ModelVersion:
        """One version by its number; see :meth:`services.registry.models.port.ModelRegistry.version`."""
        self._ready()
        with mapped(f"looking up {name}/{number}", lookup=True):
            return _version(self._client.get_model_version(name, str(number)))

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        """The version of an alias; see :meth:`services.registry.models.port.ModelRegistry.by_alias`."""
        self._ready()
        with mapped(f"looking up {name}@{alias}", lookup=True):
            return _version(self._client.get_model_version_by_alias(name, alias))

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """All versions, newest first; see :meth:`services.registry.models.port.ModelRegistry.versions`."""
        if "'" in name:
            # It would end the filter's quotes, and MLflow has no way to escape it.
            return ()
        self._ready()
        found: list[ModelVersion] = []
        token: str | None = ""
        with mapped(f"listing the versions of {name}"):
            while token is not None:
                page = self._client.search_model_versions(f"name='{name}'", _PAGE, page_token=token or None)
                found += [_version(one) for one in page]
                token = page.token or None
            aliases = self._aliases(name) if found else {}
        complete = [replace(one, aliases=aliases.get(one.number, ())) for one in found]
        return tuple(sorted(complete, key=lambda one: one.number, reverse=True))

    def names(self) -> tuple[str, ...]:
        """The registered models; see :meth:`services.registry.models.port.ModelRegistry.names`."""
        self._ready()
        found: list[str] = []
        token: str | None = ""
        with mapped("listing the models"):
            while token is not None:
                page = self._client.search_registered_models(max_results=_PAGE, page_token=token or None)
                found += [model.name for model in page]
                token = page.token or None
        return tuple(sorted(found))

    def delete(self, name: str, number: int) -> None:
        """Delete a version; see :meth:`services.registry.models.port.ModelRegistry.delete`."""
        self._ready()
        with mapped(f"deleting {name}/{number}", lookup=True):
            self._client.delete_model_version(name, str(number))

    def set_alias(self, name: str, alias: str, number: int) -> None:
        """Point an alias to a version; see :meth:`services.registry.models.port.ModelRegistry.set_alias`."""
        self._ready()
        with mapped(f"pointing {name}@{alias} to {number}", lookup=True):
            self._client.set_registered_model_alias(name, alias, str(number))

    def set_tags(self, name: str, number: int, tags: Mapping[str, str]) -> None:
        """Set tags on a version; see :meth:`services.registry.models.port.ModelRegistry.set_tags`."""
        self._ready()
        with mapped(f"setting tags on {name}/{number}", lookup=True):
            for key, value in tags.items():
                self._client.set_model_version_tag(name, str(number), key, value)

    def show(self, version: ModelVersion, shown: Shown) -> None:
        """Show figures and a note; see :meth:`services.registry.models.port.ModelRegistry.show`."""
        self._ready()
        name, number = version.name, str(version.number)
        with mapped(f"showing figures of {version}", lookup=True):
            self._client.update_model_version(name, number, shown.note)
        with mapped(f"looking up the model of {version}"):
            run = self._client.get_run(version.run_id)
            model = logged_model(self._client, name, run, version.digest)
        model_id = None if model is None else model.model_id
        now_ms, digest = time.time_ns() // 1_000_000, shown.data_digest[:MAX_DIGEST]
        points = [
            Metric(key, value, now_ms, 0, model_id, shown.data, digest, version.run_id)
            for key, value in shown.metrics.items()
        ]
        with mapped(f"showing figures of {version}"):
            self._client.log_batch(version.run_id, points)

    def remove_tag(self, name: str, number: int, tag: str) -> None:
        """Take a tag off; see :meth:`services.registry.models.port.ModelRegistry.remove_tag`."""
        self._ready()
        with mapped(f"taking a tag off {name}/{number}", lookup=True):
            self._client.delete_model_version_tag(name, str(number), tag)

    def download(self, version: ModelVersion, folder: Path) -> Path:
        """Fetch a version's bundle; see :meth:`services.registry.models.port.ModelRegistry.download`."""
        if folder.exists():
            raise StorageError("the download's folder exists", expected="a new folder", got=str(folder))
        self._ready()
        label = str(version)
        with mapped(f"looking up {label}", lookup=True):
            source = self._client.get_model_version_download_uri(version.name, str(version.number))
        check_source(label, source, self._uri, self._artifact_store)
        with mapped(f"downloading {label}"):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as beside:
                got = Path(self._fetch(f"{source}/{BUNDLE_PATH}", beside))
                if not got.is_dir() or not any(got.iterdir()):
                    raise ModelNotFoundError(
                        f"{label} holds no bundle", expected=BUNDLE_PATH, got="a model of another kind"
                    )
                got.rename(folder)
        return folder

    def _aliases(self, name: str) -> dict[int, tuple[str, ...]]:
        """By version number; MLflow's search for versions leaves them out."""
        numbers = {
            alias: int(number) for alias, number in self._client.get_registered_model(name).aliases.items()
        }
        return {
            number: tuple(sorted(alias for alias in numbers if numbers[alias] == number))
            for number in numbers.values()
        }

    def _fetch(self, source: str, folder: str) -> str:
        return str(
            download_artifacts(
                artifact_uri=source, dst_path=folder, tracking_uri=self._uri, registry_uri=self._uri
            )
        )

    def _ready(self) -> None:
        check_reachable(self._uri, self._patience_s)


def check_source(label: str, source: str, tracking_uri: str, artifact_store: str = "") -> None:
    """Refuse to fetch a version from anywhere but the artifact store.

    The registry names the place, and who may write to the registry names any: a file of this machine, or
    another server.

    Args:
        label: of the version, for messages.
        source: the address that the registry names.
        tracking_uri: of the registry. The artifacts of one that is no server are files of this machine.
        artifact_store: address of a further store whose artifacts are fetched; none when empty.

    Raises:
        RegistryError: the address is outside of both.
    """
    found, server, store = urlsplit(source), urlsplit(tracking_uri), artifact_store.rstrip("/")
    own = ("", server.netloc, server.netloc.rpartition("@")[2])
    if server.scheme not in ("http", "https"):
        is_known = found.scheme in ("", "file") and not found.netloc
    else:
        is_known = found.scheme == "mlflow-artifacts" and found.netloc in own
    is_known = is_known or (bool(store) and source.startswith(f"{store}/"))
    if not is_known or ".." in unquote(source).replace("\\", "/").split("/"):
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
