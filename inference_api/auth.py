"""API keys: long random tokens of which the server knows SHA-256 digests only.

A digest without salt or stretching is enough, because a key is 256 random bits and not a password that
somebody chose. docs/operations.md makes one with openssl.
"""

import hashlib
import re
import stat
from pathlib import Path

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from cspace.errors import ConfigError
from cspace.files import read_bounded
from inference_api.limits import HEALTH, WORKBENCH_FILES
from inference_api.problems import UNAUTHORIZED, RequestError, problem_response
from inference_api.telemetry import request_fields

REALM = 'Bearer realm="cspace-sampler"'
_LINE = re.compile(r"([A-Za-z0-9._-]{1,64}):([0-9a-f]{64})", re.ASCII)


def read_keys(path: Path) -> dict[str, str]:
    """Names by digest, of lines ``name:sha256``; empty lines and those with ``#`` first do not count."""
    data = read_bounded(path, 2**20, ConfigError, remedy="name another one in CSPACE_API_KEYS_FILE")
    mode = path.stat().st_mode
    if mode & (stat.S_IWGRP | stat.S_IWOTH):
        # Whoever writes a digest into it has a key.
        raise ConfigError(
            f"the file of API keys {path} is not its owner's alone",
            expected="a file that its owner alone may write",
            got=f"mode {stat.filemode(mode)}",
            remedy=f"chmod go-w {path}",
        )
    lines = [line.strip() for line in data.decode(errors="replace").splitlines()]
    matches = [_LINE.fullmatch(line) for line in lines if line and not line.startswith("#")]
    keys = {match[2]: match[1] for match in matches if match is not None}
    if not keys or None in matches:
        # No line is repeated: somebody may have pasted the key itself.
        raise ConfigError(
            f"the file of API keys {path} is wrong",
            expected="lines name:sha256",
            got="another line" if matches else "no key",
            remedy="make lines as docs/operations.md does",
        )
    return keys


class RequireKey:
    """ASGI middleware: answers 401 without a known key, and leaves its name in ``state.client``."""

    def __init__(self, app: ASGIApp, keys: dict[str, str]) -> None:
        self._app, self._keys = app, keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = scope.get("path", "")
        is_open = path in (*HEALTH, "/") or path.startswith(f"{WORKBENCH_FILES}/")
        if scope["type"] == "http" and not is_open:
            sent = Headers(scope=scope).getlist("authorization")
            scheme, _, token = sent[0].strip().partition(" ") if len(sent) == 1 else ("", "", "")
            token = token.strip() if scheme.lower() == "bearer" else ""
            name = self._keys.get(digest_of(token))
            if name is None:
                error = RequestError(
                    UNAUTHORIZED,
                    "this server answers callers with an API key only",
                    expected="Authorization: Bearer KEY",
                    # What came is not repeated: it may be a key with one letter wrong.
                    got="an unknown key" if token else "no key",
                    remedy="ask whoever runs the server for a key",
                    headers={"WWW-Authenticate": f'{REALM}, error="invalid_token"' if token else REALM},
                )
                await problem_response(error)(scope, receive, send)
                return
            scope["state"]["client"] = request_fields.get()["client"] = name
        await self._app(scope, receive, send)


def digest_of(token: str) -> str:
    """SHA-256 of a key, in hexadecimal."""
    return hashlib.sha256(token.encode(errors="surrogateescape")).hexdigest()
