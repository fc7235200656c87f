"""What a console was started with: its addresses, and what follows from them. Pure.

An origin is what a browser sends as `Origin` (RFC 6454): scheme, name, and the port unless it is
the scheme's own. The first one is the console's address as people are told it.
"""

import json
from dataclasses import asdict, dataclass
from typing import Final
from urllib.parse import urlsplit

LIFETIME: Final = 8 * 3600  # seconds of a session
IDLE: Final = 30 * 60  # seconds without use after which a session ends
ON_THE_WALL: Final = 90 * 86400  # seconds of a session that can only look, which nobody touches


@dataclass(frozen=True)
class Settings:
    """Of one console.

    Args:
        domain: the trust domain's name.
        origins: the addresses under which it is used; of the first one are links and passkeys.
        users: user ids whose programs on this host may connect; None: it is not on localhost.
        hsts: whether browsers shall insist on https for this name.
        read_only: whether pages only show.
        lifetime, idle: of sessions, in seconds.
        proxy_users: whose programs may connect at a unix socket, as a proxy.
    """

    domain: str
    origins: tuple[str, ...]
    users: frozenset[int] | None = None
    hsts: bool = False
    read_only: bool = False
    lifetime: int = LIFETIME
    idle: int = IDLE
    proxy_users: frozenset[int] = frozenset()

    @property
    def origin(self) -> str:
        """The address as people are told it."""
        return self.origins[0]

    @property
    def rp_id(self) -> str:
        """The name that passkeys belong to (WebAuthn: relying party identifier)."""
        return urlsplit(self.origin).hostname or ""

    @property
    def hosts(self) -> frozenset[str]:
        """What a request's `Host` may be."""
        return frozenset(urlsplit(origin).netloc for origin in self.origins)


def write_settings(settings: Settings) -> str:
    """Settings as text, for the web process's command line: nothing in them is secret."""
    fields = asdict(settings)
    fields["users"] = None if settings.users is None else sorted(settings.users)
    fields["proxy_users"] = sorted(settings.proxy_users)
    return json.dumps(fields)


def read_settings(text: str) -> Settings:
    """The settings that `write_settings` wrote."""
    fields = json.loads(text)
    fields["origins"] = tuple(fields["origins"])
    fields["users"] = None if fields["users"] is None else frozenset(fields["users"])
    fields["proxy_users"] = frozenset(fields["proxy_users"])
    return Settings(**fields)
