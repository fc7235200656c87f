"""Between the supervisor and its web process: frames over a socketpair. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR: a word of
`WORDS` and its arguments. Whichever side ends, the other sees the end of the stream.

What a console was started with: its addresses, and what follows from them. Pure.

An origin is what a browser sends as `Origin` (RFC 6454): scheme, name, and the port unless it is
the scheme's own. The first one is the console's address as people are told it.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError
from rossec.authority.keyservice.messages import HEAD
from rossec.errors import KeyMessageRefused

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
        return self.origins[0]

    @property
    def rp_id(self) -> str:
        return urlsplit(self.origin).hostname or ""

    @property
    def hosts(self) -> frozenset[str]:
        return frozenset(urlsplit(origin).netloc for origin in self.origins)


def write_settings(settings: Settings) -> str:
    """Settings as text, for the web process's command line: nothing in them is secret."""
    fields = asdict(settings)
    fields["users"] = None if settings.users is None else sorted(settings.users)
    fields["proxy_users"] = sorted(settings.proxy_users)
    return json.dumps(fields)


def read_settings(text: str) -> Settings:
    fields = json.loads(text)
    fields["origins"] = tuple(fields["origins"])
    fields["users"] = None if fields["users"] is None else frozenset(fields["users"])
    fields["proxy_users"] = frozenset(fields["proxy_users"])
    return Settings(**fields)


MAX_FRAME: Final = 128 * 1024

READY, CERTIFICATE = "ready", "certificate"
WORDS: Final[Mapping[str, tuple[type, ...]]] = {
    READY: (),  # from the web process: it serves
    CERTIFICATE: (bytes,),  # from the supervisor: key and chain, PEM, for connections from now on
}


class ControlMessage(NamedTuple):
    word: str
    arguments: tuple[Value, ...] = ()


def write(word: ControlMessage) -> bytes:
    body = encode([word.word, *word.arguments])
    return len(body).to_bytes(HEAD) + body


def read(body: bytes) -> ControlMessage:
    try:
        value = decode(body, limit=MAX_FRAME)
    except EncodingError as error:
        raise KeyMessageRefused(f"a word that is malformed: {error}") from error
    match value:
        case [str() as word, *arguments] if word in WORDS:
            if tuple(map(type, arguments)) == WORDS[word]:
                return ControlMessage(word, tuple(arguments))
    raise KeyMessageRefused("a word that is not in the table")
