"""Where a page of the console may be, and what name its passkeys may have. Pure.

Web Authentication section 5.1.3: the RP id is the host of the page, or a parent domain of it. Only
https, and http on `localhost`, are secure contexts; an IP address has no passkeys.
"""

import ipaddress
import re
from typing import Final
from urllib.parse import urlsplit

from ca.errors import PasskeyRefused

MAX_ORIGIN: Final = 300
_LABEL: Final = "[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
_DOMAIN: Final = re.compile(rf"{_LABEL}(\.{_LABEL})*")


def check_page(origin: str, rp_id: str) -> None:
    """Return if a page at `origin` can have passkeys for `rp_id`.

    Raises:
        PasskeyRefused: it cannot.
    """
    host = _host(origin)
    if host is None:
        raise PasskeyRefused(
            f"{origin[:80]!a} is no address of a console", "https://NAME, or http://localhost"
        )
    if not _DOMAIN.fullmatch(rp_id) or _is_address(rp_id):
        raise PasskeyRefused(
            f"passkeys cannot belong to {rp_id[:80]!a}", "open the console by a name"
        )
    if host != rp_id and not host.endswith(f".{rp_id}"):
        raise PasskeyRefused(
            f"a page at {host} has no passkeys of {rp_id}", "open the console by its own name"
        )


def _host(origin: str) -> str | None:
    """The host of exactly an origin (RFC 6454), if it is a secure context."""
    if len(origin) > MAX_ORIGIN:
        return None
    try:
        parts = urlsplit(origin)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        return None
    shown = host if port is None else f"{host}:{port}"
    if origin != f"{parts.scheme}://{shown}" or not _DOMAIN.fullmatch(host):
        return None
    is_secure = parts.scheme == "https" or (parts.scheme == "http" and host == "localhost")
    return host if is_secure else None


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
