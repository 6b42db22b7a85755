"""Page token: what a page must know; one of this user's for a port, so that a page outlives a restart of its server."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import stat
import time
from collections.abc import Callable
from pathlib import Path

LONGEST_KEPT = 24 * 3600.0
"""Seconds after which a server that starts takes a new token."""
FORM = re.compile(r"[A-Za-z0-9_-]{22}")
NONCE = re.compile(r"[0-9a-f]{32}")
"""What a page may ask a proof for: 16 bytes of its own choice, in hexadecimal."""


def page_token(port: int) -> str:
    """The token of the server that this user had on a port before, for LONGEST_KEPT from when it was made; else, and on
    port 0, a new one. It lies in a file that nobody else can read; where there can be none, each server has its own.
    """
    new = secrets.token_urlsafe(16)
    if not port:
        return new
    try:
        file = folder() / f"view-{port}.token"
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _check_private(file.parent.lstat(), stat.S_ISDIR)
        return _read(file) or _written(file, new)
    except OSError:
        return new


def folder() -> Path:
    """Of the files: that of the login, which ends with it, or where a user's programs keep their state."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    state = os.environ.get("XDG_STATE_HOME", "")
    place = Path(runtime or state or os.path.expanduser("~/.local/state"))
    if not place.is_absolute():
        raise OSError(f"{place}: no place for a file that others must not read")
    return place / "hybrid_sysid_ros"


def proof(token: str, nonce: str) -> str:
    """What only a server that knows the token can answer to a nonce: a page tells its own token to no other program
    that has got the port meanwhile. HMAC-SHA256 (RFC 2104), in hexadecimal.
    """
    return hmac.new(token.encode(), nonce.encode(), hashlib.sha256).hexdigest()


def _read(file: Path) -> str:
    """The token in a file, "" where there is none, or an old one."""
    try:
        handle = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return ""
    with open(handle, encoding="ascii", errors="replace") as opened:
        found = os.fstat(handle)
        _check_private(found, stat.S_ISREG)
        text = opened.read(100).strip()
    age = time.time() - found.st_mtime
    return text if FORM.fullmatch(text) and 0.0 <= age < LONGEST_KEPT else ""


def _written(file: Path, token: str) -> str:
    """The token, once it is in the file."""
    partial = file.with_name(f"{file.name}.{secrets.token_hex(8)}")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(handle, "w", encoding="ascii") as opened:
        opened.write(f"{token}\n")
    os.replace(partial, file)
    return token


def _check_private(found: os.stat_result, is_kind: Callable[[int], bool]) -> None:
    """Raise OSError for what is not of this user alone, or of another kind."""
    if found.st_uid != os.geteuid() or found.st_mode & 0o077 or not is_kind(found.st_mode):
        raise OSError("others can read or replace it")
