from types import SimpleNamespace

import pytest

from cspace.bundle.files import read_files
from cspace.errors import ConfigError
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry
from training.jobs import job

OWN = PlanarWorld(PlanarArm((1.0, 1.0)))


class StubJob:
    """A job of which only its registry is asked."""

    environment = SimpleNamespace(tracking_uri="fake")

    def patiently(self, _, call):
        return call()


@pytest.fixture
def registry(tmp_path, monkeypatch):
    found = FakeRegistry(tmp_path / "registry")
    monkeypatch.setattr(job, "ModelRegistry", lambda _: found)
    return found


def add(registry, name, bundle):
    registry.register(name, bundle, "run", read_files(bundle).digest, {})


def test_a_name_that_the_registry_has_for_another_robot_is_refused(registry, tmp_path):
    assert job.registered_name(StubJob(), OWN, "arm-7", path=False) == "arm-7-sampler"
    add(registry, "arm-7-sampler", write_tiny_bundle(tmp_path / "own", OWN.body))
    assert job.registered_name(StubJob(), OWN, "arm-7", path=True) == "arm-7-path-sampler"
    other = PlanarWorld(PlanarArm((1.0, 1.1)))
    for path in (False, True):
        with pytest.raises(ConfigError, match="arm-7-sampler/1 is of robot"):
            job.registered_name(StubJob(), other, "arm-7", path=path)
