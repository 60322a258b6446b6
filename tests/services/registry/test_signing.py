"""Signed bundles, by the real package: what was signed is served, and nothing else."""

from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from cspace.bundle import Bundle
from cspace.errors import BundleIntegrityError, ConfigError
from inference_api.problems import ModelNotReadyError
from inference_api.served_models import ModelStore
from inference_api.settings import ApiSettings
from services.registry import promotion
from services.registry.entities import ModelReference, ModelVersion
from services.registry.signing import require_signature
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry


def key(folder: Path, name: str) -> tuple[Path, Path]:
    """Files of a new private key and its public one."""
    made = ec.generate_private_key(ec.SECP256R1())
    private, public = folder / f"{name}.pem", folder / f"{name}.pub"
    plain = serialization.NoEncryption()
    private.write_bytes(
        made.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
    )
    public.write_bytes(
        made.public_key().public_bytes(
            serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
        )
    )
    return private, public


@pytest.fixture
def signed(tmp_path: Path) -> tuple[FakeRegistry, ModelVersion, Path]:
    """A registry with one signed version, and the public key."""
    private, public = key(tmp_path, "lab")
    registry = FakeRegistry(tmp_path / "registry")
    folder = write_tiny_bundle(tmp_path / "bundle")
    version = registry.register("arm-sampler", folder, "run", Bundle.load(folder).digest, {})
    promotion.sign(registry, version, private)
    return registry, registry.version("arm-sampler", 1), public


def test_what_was_signed_is_served_and_nothing_else(
    signed: tuple[FakeRegistry, ModelVersion, Path], tmp_path: Path
) -> None:
    registry, version, public = signed
    other = key(tmp_path, "other")[1]

    def load(trusted: Path) -> Bundle:
        settings = ApiSettings(
            model_cache=tmp_path / "cache", pretrained_model=tmp_path / "none", trusted_key=trusted
        )
        store = ModelStore(settings, lambda: registry, lambda path, _: Bundle.load(path))
        return store.get(ModelReference(version.name, version=1)).bundle

    assert load(public).digest == version.digest
    with pytest.raises(ModelNotReadyError, match=r"does not hold.*other\.pub.*Key mismatch"):
        load(other)
    registry.remove_tag(version.name, 1, "signature")
    with pytest.raises(ModelNotReadyError, match=r"not signed.*models sign"):
        load(public)


def test_a_signature_holds_for_no_other_name_version_or_files(
    signed: tuple[FakeRegistry, ModelVersion, Path], tmp_path: Path
) -> None:
    registry, version, public = signed
    folder = registry.download(version, tmp_path / "own")
    require_signature(folder, version, public)
    changed = write_tiny_bundle(tmp_path / "changed", scale=0.5)
    for where, claimed in (
        (folder, replace(version, name="other")),
        (folder, replace(version, number=2)),
        (changed, version),
        (folder, replace(version, tags={"signature": "{}"})),
    ):
        with pytest.raises(BundleIntegrityError, match="does not hold"):
            require_signature(where, claimed, public)
    (folder / "golden.npz").write_bytes(b"damaged")
    with pytest.raises(BundleIntegrityError, match=r"golden\.npz"):
        require_signature(folder, version, public)


def test_a_file_that_is_no_key_is_refused(signed: tuple[FakeRegistry, ModelVersion, Path]) -> None:
    registry, version, public = signed
    with pytest.raises(ConfigError, match="private key"):
        promotion.sign(registry, version, public)
    assert registry.version("arm-sampler", 1).tags == version.tags
