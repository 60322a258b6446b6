"""A champion whose graphs attack whoever runs them: refused apart, while the default goes on answering."""

import logging
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from cspace.bundle.files import read_files
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.parts import Limits, parts_apart
from inference_api.models.bundle_cache import BundleCache
from inference_api.models.shipped import ShippedModels
from inference_api.models.store import ModelStore
from inference_api.telemetry.observer import Observer, Refusal
from services.registry.models.port import ModelVersion
from services.registry.references import PRETRAINED, ModelReference
from tests.inference_api.bad_bundles import write_hungry_bundle, write_slow_bundle

QUICK_S = 2.0
DEFAULT = ModelReference("m")


class Refusals(Observer):
    """Notes why champions did not come into service."""

    def __init__(self) -> None:
        self.reasons: list[Refusal] = []

    def refused(self, reason: Refusal) -> None:
        self.reasons.append(reason)


@pytest.mark.parametrize(
    ("write", "verify_s", "reason"),
    [
        (write_slow_bundle, 2.0, "the bundle does not stand its verification"),
        (write_hungry_bundle, 60.0, "encoder.onnx cannot be opened"),
    ],
)
def test_it_is_refused_in_time_and_takes_nothing_of_this_process(
    tmp_path: Path,
    bundles: dict[str, Path],
    caplog: pytest.LogCaptureFixture,
    write: Callable[[Path], Path],
    verify_s: float,
    reason: str,
) -> None:
    # The registry is away, so that the last champion that was known is the one to serve.
    disk = DiskCache(tmp_path / "cache")
    bundle = write(tmp_path / "bad")
    champion = ModelVersion("m", 1, "", read_files(bundle).digest, ("champion",), {}, 0)
    disk.download(champion, lambda _, folder: Path(shutil.copytree(bundle, folder)))
    disk.remember_champion(champion)
    parts = parts_apart(disk, "http://127.0.0.1:9", Limits(verify_s=verify_s))
    cache = BundleCache(disk, parts.loader, 2)
    store = ModelStore(
        parts.registry, cache, ShippedModels({PRETRAINED: bundles["shipped"]}), "m", children=parts.children
    )
    store.observer = seen = Refusals()
    store.load_shipped()
    before = psutil.Process().memory_info().rss
    # Other tests of this process may have left some of their own.
    others = set(psutil.Process().children(recursive=True))
    try:
        store.start()
        with caplog.at_level(logging.WARNING):
            looking = threading.Thread(target=store.refresh, daemon=True)
            looking.start()
            slowest_s = 0.0
            while looking.is_alive():
                began_s = time.perf_counter()
                assert store.resolve(DEFAULT).fallback
                slowest_s = max(slowest_s, time.perf_counter() - began_s)
                looking.join(0.01)
        # Nobody waits for the verification.
        assert slowest_s < QUICK_S
        assert f"m/1 cannot follow: {reason}" in caplog.text
        assert str(tmp_path) not in caplog.text
        # It was taken off the disk, and cannot be had again while the registry is away.
        assert store.successor == "refused"
        assert disk.stored("m") == []
        assert seen.reasons == ["bundle"]
        assert psutil.Process().memory_info().rss - before < 20 * 2**20
    finally:
        store.close()
    assert set(psutil.Process().children(recursive=True)) <= others
