"""A node's address and its token, kept apart: the token stands in no ledger, message or log."""

from __future__ import annotations

import os
from typing import Optional, Tuple
from urllib.parse import parse_qs, urlsplit, urlunsplit

from ...stages.errors import UsageError

TOKEN_VARIABLE = "SENSORGATE_NODE_TOKEN"


def split_address(url: str, token: Optional[str] = None) -> Tuple[str, str]:
    """An address without its token, and the token: the argument's, else the address's, else the environment's."""
    text = url.strip()
    if "://" not in text:
        text = f"http://{text}"
    parts = urlsplit(text)
    try:
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise UsageError(f"{url!r} is no address of a node: {error}.") from error
    if parts.scheme not in ("http", "https") or not host:
        raise UsageError(f"{bare(url)} is no address of a node. It looks like http://localhost:3000?token=...")
    given = parse_qs(parts.query).get("token", [""])[0]
    address = urlunsplit((parts.scheme, parts.netloc, parts.path.rstrip("/"), "", ""))
    return address, token or given or os.environ.get(TOKEN_VARIABLE, "")


def bare(url: str) -> str:
    """The address without what may hold a token."""
    return url.partition("?")[0]
