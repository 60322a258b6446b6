"""Signatures of bundles by keys, made and checked by the package model-signing, each in a process of its own.

A version carries its signature as a tag, so that it goes with whatever the registry stores.
"""

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from cspace.errors import BundleIntegrityError, ConfigError, ServiceError

LIMIT_S = 60.0
# Of ten files; more is none.
MAX_BYTES = 64 * 2**10
_SAYS = "failed with error:"


def sign(folder: Path, private_key: Path) -> str:
    """The signature of a folder's files, JSON.

    Args:
        folder: of a bundle.
        private_key: PEM file of an elliptic curve's key without a password.

    Raises:
        ConfigError: the file holds no such key.
        ServiceError: the package is missing, or its process does not end.
    """
    with tempfile.TemporaryDirectory(prefix="cspace-signature-") as temporary:
        made = Path(temporary, "model.sig")
        said = _run("sign", folder, made, "--private_key", private_key)
        if said is not None:
            raise ConfigError(
                "the bundle cannot be signed",
                expected="a PEM file with the private key of an elliptic curve, without a password",
                got=said,
            )
        return made.read_text("utf-8")


def require_signature(folder: Path, signature: str | None, public_key: Path) -> None:
    """Refuse a bundle whose files are not those that the owner of a key has signed.

    Args:
        folder: of the bundle.
        signature: what :func:`sign` returned; None where there is none.
        public_key: PEM file.

    Raises:
        BundleIntegrityError: the signature is missing, another key's, or of other files.
        ServiceError: the package is missing, or its process does not end.
    """
    expected = f"a signature by the key {public_key.name}"
    if signature is None:
        raise BundleIntegrityError(
            "the bundle is not signed",
            expected=expected,
            got="none",
            remedy="python -m services.registry models sign NAME/VERSION --key FILE",
        )
    with tempfile.TemporaryDirectory(prefix="cspace-signature-") as temporary:
        written = Path(temporary, "model.sig")
        written.write_text(signature[:MAX_BYTES], "utf-8")
        said = _run("verify", folder, written, "--public_key", public_key)
    if said is not None:
        raise BundleIntegrityError("the bundle's signature does not hold", expected=expected, got=said)


def _run(what: str, folder: Path, signature: Path, option: str, key: Path) -> str | None:
    """Runs the package's command; None where it did it, else what it says."""
    if find_spec("model_signing") is None:
        raise ServiceError(
            "signatures need a package", got="no model-signing", remedy="install cspace-sampler[signing]"
        )
    command = [sys.executable, "-m", "model_signing", what, "key", str(folder.absolute())]
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
