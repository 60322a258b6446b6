"""API keys: long random tokens of which the server knows SHA-256 digests only.

``python -m inference_api.auth NAME`` makes one. A digest without salt or stretching is enough here and here
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
from contextlib import suppress
from pathlib import Path

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from cspace.errors import ConfigError
from cspace.files import read_bounded
from inference_api.problems import UNAUTHORIZED, RequestError, problem_response
from inference_api.telemetry import request_record

PREFIX = "csk_"
KEY_BYTES = 32
# Some thousand keys.
MAX_FILE_BYTES = 2**20
REALM = 'Bearer realm="cspace-sampler"'
_LOG = logging.getLogger(__name__)
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)
_DIGEST = re.compile(r"[0-9a-f]{64}", re.ASCII)


class ApiKeys:
    """The keys that a server takes: SHA-256 in hexadecimal by the name of the key's holder."""

    def __init__(self, digests: Mapping[str, str]) -> None:
        self._digests = dict(digests)

    @classmethod
    def read(cls, path: Path) -> "ApiKeys":
        """Read a file of lines ``name:sha256``; empty lines and those with ``#`` first do not count.

        Raises:
            ConfigError: the file cannot be read, others than its owner may write it, or a line is wrong.
        """
        remedy = "name another one in CSPACE_API_KEYS_FILE"
        data = read_bounded(path, MAX_FILE_BYTES, ConfigError, remedy=remedy)
        mode = path.stat().st_mode
        if mode & (stat.S_IWGRP | stat.S_IWOTH):
            # Whoever writes a digest into it has a key.
            raise ConfigError(
                f"the file of API keys {path} is not its owner's alone",
                expected="a file that its owner alone may write",
                got=f"mode {stat.filemode(mode)}",
                remedy=f"chmod go-w {path}",
            )
        if mode & stat.S_IROTH:
            _LOG.warning("everybody on this machine may read the file of API keys; chmod o-r")
        digests: dict[str, str] = {}
        for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), start=1):
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
        names = [name for name, known in self._digests.items() if hmac.compare_digest(digest, known)]
        return names[0] if names else None


class RequireKey:
    """ASGI middleware: answers 401 without a known key, and leaves its name in ``state.client``.

    Args:
        app: what is protected.
        keys: the known ones.
        open_paths: need none; those that end in ``/`` with all below them.
    """

    def __init__(self, app: ASGIApp, keys: ApiKeys, open_paths: tuple[str, ...]) -> None:
        self._app, self._keys, self._open = app, keys, frozenset(open_paths)
        self._open_below = tuple(path for path in open_paths if len(path) > 1 and path.endswith("/"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on, or refuses it."""
        path = scope.get("path", "")
        if scope["type"] == "http" and path not in self._open and not path.startswith(self._open_below):
            sent = Headers(scope=scope).getlist("authorization")
            scheme, _, token = sent[0].strip().partition(" ") if len(sent) == 1 else ("", "", "")
            token = token.strip() if scheme.lower() == "bearer" else ""
            name = self._keys.name_of(token) if token else None
            if name is None:
                await problem_response(_unauthorized(has_token=bool(token)))(scope, receive, send)
                return
            scope.setdefault("state", {})["client"] = name
            record = request_record.get()
            if record is not None:
                record.client = name
        await self._app(scope, receive, send)


def _unauthorized(*, has_token: bool) -> RequestError:
    challenge = f'{REALM}, error="invalid_token"' if has_token else REALM
    return RequestError(
        UNAUTHORIZED,
        "this server answers callers with an API key only",
        expected="Authorization: Bearer KEY",
        # What came is not repeated: it may be a key with one letter wrong.
        got="an unknown key" if has_token else "no key",
        remedy="ask whoever runs the server for a key",
        headers={"WWW-Authenticate": challenge},
    )


def check_exposure(host: str, keys_file: Path | None, *, allowed: bool) -> None:
    """Refuses to listen where other machines may ask without a key, unless whoever starts it wants that.

    Raises:
        ConfigError: no keys and another address than loopback, or a wrong file of keys.
    """
    if keys_file is not None:
        ApiKeys.read(keys_file)
    elif not allowed and not _is_loopback(host):
        raise ConfigError(
            "everybody who reaches the server could use it",
            expected="a loopback address, or keys",
            got=f"--host {host!r} without CSPACE_API_KEYS_FILE",
            remedy="make keys with python -m inference_api.auth NAME, or say --allow-unauthenticated",
        )


def _is_loopback(host: str) -> bool:
    # A name may mean any address.
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def digest_of(token: str) -> str:
    """SHA-256 of a key, in hexadecimal."""
    return hashlib.sha256(token.encode("utf-8", errors="surrogateescape")).hexdigest()


def make_key() -> str:
    """A new key with 256 random bits."""
    return PREFIX + secrets.token_urlsafe(KEY_BYTES)


def main(arguments: list[str] | None = None) -> int:
    """Make a key and print it, this once; 2 for a wrong name."""
    parser = argparse.ArgumentParser(
        prog="python -m inference_api.auth",
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
        remedy="make lines with python -m inference_api.auth NAME",
    )


if __name__ == "__main__":
    sys.exit(main())
