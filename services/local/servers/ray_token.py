"""The token that Ray asks every client for. It is the user's, kept where Ray itself looks for it."""

import os
import secrets
from collections.abc import Mapping
from pathlib import Path

from cspace.errors import ServiceStartError
from cspace.files import replacing


def token_headers(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The header that carries the token; empty where there is none yet."""
    token = read_token(environment)
    return {} if token is None else {"Authorization": f"Bearer {token}"}


def read_token(environment: Mapping[str, str] = os.environ) -> str | None:
    """The token in Ray's own order: its variable, the file that a variable names, the file at home.

    Raises:
        ServiceStartError: the file cannot be read.
    """
    token = environment.get("RAY_AUTH_TOKEN", "").strip()
    if token:
        return token
    path = _token_path(environment)
    try:
        return path.read_text(encoding="utf-8").strip() or None
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise ServiceStartError(f"Ray's token {path} cannot be read", got=str(error)) from error


def ensure_token(environment: Mapping[str, str] = os.environ) -> None:
    """Make a token, readable by this user alone, unless there is one.

    The same as `ray get-auth-token --generate`, without starting Ray's command line for it.

    Raises:
        ServiceStartError: it cannot be made.
    """
    if read_token(environment) is not None:
        return
    path = _token_path(environment)
    if environment.get("RAY_AUTH_TOKEN_PATH"):
        raise ServiceStartError(
            "the file that RAY_AUTH_TOKEN_PATH names holds no token",
            got=str(path),
            remedy="put one there, or unset the variable to have one made",
        )
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        with replacing(path) as beside:
            beside.touch(mode=0o600)
            beside.write_text(secrets.token_hex(32), encoding="utf-8")
    except OSError as error:
        raise ServiceStartError(f"Ray's token {path} cannot be made", got=str(error)) from error


def _token_path(environment: Mapping[str, str]) -> Path:
    named = environment.get("RAY_AUTH_TOKEN_PATH")
    return Path(named) if named else Path(environment.get("HOME") or Path.home()) / ".ray" / "auth_token"
