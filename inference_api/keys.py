"""API keys: long random tokens of which the server knows SHA-256 digests only.

``python -m inference_api.keys NAME`` makes one. A digest without salt or stretching is enough here and here
only, because a key is 256 random bits and not a password that somebody chose.
"""

import argparse
import hashlib
import hmac
import ipaddress
import logging
import re
import secrets
import stat
import sys
from collections.abc import Mapping
from pathlib import Path

from cspace.errors import ConfigError
from cspace.files import read_bounded

PREFIX = "csk_"
KEY_BYTES = 32
# Some thousand keys.
MAX_FILE_BYTES = 2**20
_LOG = logging.getLogger(__name__)
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)
_DIGEST = re.compile(r"[0-9a-f]{64}", re.ASCII)


class ApiKeys:
    """The keys that a server takes.

    Args:
        digests: SHA-256 in hexadecimal by the name of the key's holder.
    """

    def __init__(self, digests: Mapping[str, str]) -> None:
        self._digests = dict(digests)

    @classmethod
    def read(cls, path: Path) -> "ApiKeys":
        """Read a file of lines ``name:sha256``; empty lines and those with ``#`` first do not count.

        Raises:
            ConfigError: the file cannot be read or is larger than 1 MiB, may be written by others than its
                owner, holds no key, or a line is wrong.
        """
        remedy = "name another one in CSPACE_API_KEYS_FILE"
        data = read_bounded(path, MAX_FILE_BYTES, ConfigError, remedy=remedy)
        try:
            mode = path.stat().st_mode
            lines = data.decode("utf-8").splitlines()
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"the file of API keys {path} cannot be read",
                got=str(error),
                remedy=remedy,
            ) from error
        if mode & _OTHERS_WRITE:
            # Whoever writes a digest into it has a key.
            raise ConfigError(
                f"the file of API keys {path} is not its owner's alone",
                expected="a file that its owner alone may write",
                got=f"mode {stat.filemode(mode)}",
                remedy=f"chmod go-w {path}",
            )
        digests: dict[str, str] = {}
        for number, line in enumerate(lines, start=1):
            entry = line.strip()
            if not entry or entry.startswith("#"):
                continue
            name, _, digest = entry.partition(":")
            if not _NAME.fullmatch(name) or not _DIGEST.fullmatch(digest) or name in digests:
                # The line is not repeated: somebody may have pasted the key itself.
                raise _wrong_file(path, f"another line {number}")
            digests[name] = digest
        if not digests:
            raise _wrong_file(path, "no key")
        return cls(digests)

    def name_of(self, token: str) -> str | None:
        """The holder of a key, None for an unknown one; takes as long whichever it is."""
        digest = digest_of(token)
        found = None
        for name, known in self._digests.items():
            if hmac.compare_digest(digest, known):
                found = name
        return found


def bearer_token(headers: list[str]) -> str | None:
    """The token of the one ``Authorization`` header; None without one, with several, or in another scheme."""
    if len(headers) != 1:
        return None
    scheme, _, token = headers[0].strip().partition(" ")
    return token.strip() if scheme.lower() == "bearer" and token.strip() else None


def check_exposure(host: str, keys_file: Path | None, *, allowed: bool) -> None:
    """Refuses to listen where other machines may ask without a key.

    Args:
        host: address to listen on.
        keys_file: which is read here, so that a wrong one is told before the start.
        allowed: whether whoever starts the server wants just that.

    Raises:
        ConfigError: no keys and another address than loopback, or a wrong file of keys.
    """
    if keys_file is not None:
        ApiKeys.read(keys_file)
    elif not allowed and not is_loopback(host):
        raise ConfigError(
            "everybody who reaches the server could use it",
            expected="a loopback address, or keys",
            got=f"--host {host!r} without CSPACE_API_KEYS_FILE",
            remedy="make keys with python -m inference_api.keys NAME, or say --allow-unauthenticated",
        )


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address; a name other than localhost counts as reachable."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def warn_of_readers(path: Path) -> None:
    """Say in the log that a file of keys can be read by everybody; secrets of containers are mounted so."""
    if path.stat().st_mode & stat.S_IROTH:
        _LOG.warning(
            "everybody on this machine may read the file of API keys; it holds digests only; chmod o-r"
        )


def digest_of(token: str) -> str:
    """SHA-256 of a key, in hexadecimal."""
    return hashlib.sha256(token.encode("utf-8", errors="surrogateescape")).hexdigest()


def make_key() -> str:
    """A new key with 256 random bits."""
    return PREFIX + secrets.token_urlsafe(KEY_BYTES)


def main(arguments: list[str] | None = None) -> int:
    """Make a key and print it, this once; 2 for a wrong name."""
    parser = argparse.ArgumentParser(
        prog="python -m inference_api.keys",
        description="Make an API key: prints the key for its holder and the line for CSPACE_API_KEYS_FILE.",
    )
    parser.add_argument("name", help="whose key it is: 1 to 64 letters, digits, dots, dashes, underscores")
    name = parser.parse_args(arguments).name
    if not _NAME.fullmatch(name):
        parser.error(f"expected a name of letters, digits, dots, dashes and underscores; got {name!r}")
    key = make_key()
    sys.stdout.write(f"key, shown this once: {key}\n{name}:{digest_of(key)}\n")
    return 0


def _wrong_file(path: Path, got: str) -> ConfigError:
    return ConfigError(
        f"the file of API keys {path} is wrong",
        expected="lines name:sha256, each name once",
        got=got,
        remedy="make lines with python -m inference_api.keys NAME",
    )


if __name__ == "__main__":
    sys.exit(main())
