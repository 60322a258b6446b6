"""Signatures of versions by the package model-signing, whose command runs in a process of its own.

What is signed is a statement of the model's name, the version's number and the bundle's digest, which covers
every file. So a signature holds for no other name, no other version and no other files. A version carries it
as a tag.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from cspace.bundle.files import read_files
from cspace.errors import BundleIntegrityError, ConfigError, ServiceError
from services.names import TAG_SIGNATURE
from services.registry.entities import ModelVersion

LIMIT_S = 60.0
# A signature has about 2 kB.
MAX_BYTES = 64 * 2**10
_SAYS = "failed with error:"


def sign(folder: Path, version: ModelVersion, private_key: Path) -> str:
    """The signature, JSON, of a version whose bundle is in a folder.

    ``private_key`` is a PEM file of an elliptic curve's key without a password.
    """
    with _statement(folder, version) as (signed, signature):
        said = _run("sign", signed, signature, "--private_key", private_key)
        if said is not None:
            raise ConfigError(
                "the bundle cannot be signed",
                expected="a PEM file with the private key of an elliptic curve, without a password",
                got=said,
            )
        return signature.read_text("utf-8")


def require_signature(folder: Path, version: ModelVersion, public_key: Path) -> None:
    """Refuse a bundle that the owner of a key has not signed as this version; raises BundleIntegrityError."""
    expected = f"a signature of {version} by the key {public_key.name}"
    if TAG_SIGNATURE not in version.tags:
        raise BundleIntegrityError(
            "the bundle is not signed",
            expected=expected,
            got="none",
            remedy="python -m services.registry models sign NAME/VERSION --key FILE",
        )
    with _statement(folder, version) as (signed, signature):
        signature.write_text(version.tags[TAG_SIGNATURE][:MAX_BYTES], "utf-8")
        said = _run("verify", signed, signature, "--public_key", public_key)
    if said is not None:
        raise BundleIntegrityError("the bundle's signature does not hold", expected=expected, got=said)


@contextmanager
def _statement(folder: Path, version: ModelVersion) -> Iterator[tuple[Path, Path]]:
    """A folder with the statement alone, and where its signature is to be."""
    statement = {"name": version.name, "version": version.number, "digest": read_files(folder).digest}
    with tempfile.TemporaryDirectory(prefix="cspace-signature-") as temporary:
        signed = Path(temporary, "signed")
        signed.mkdir()
        (signed / "version.json").write_text(json.dumps(statement, sort_keys=True), "utf-8")
        yield signed, Path(temporary, "model.sig")


def _run(what: str, folder: Path, signature: Path, option: str, key: Path) -> str | None:
    """Run the package's command; None where it succeeded, else what it says."""
    if find_spec("model_signing") is None:
        raise ServiceError(
            "signatures need a package", got="no model-signing", remedy="install cspace-sampler[signing]"
        )
    command = [sys.executable, "-m", "model_signing", what, "key", str(folder)]
    command += ["--signature", str(signature), option, str(key.absolute())]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("OTEL_")}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=LIMIT_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ServiceError("signatures cannot be handled", got=type(error).__name__) from None
    if done.returncode == 0:
        return None
    said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    return said[-1].partition(_SAYS)[2].strip()[:300] or said[-1][:300]
