"""Between the supervisor and its web process: what a console was started with, and frames. Pure.

A frame (`messages`) is deterministic CBOR: a word of `WORDS` and its arguments. Whichever side ends, the
other sees the end of the stream.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from ca.encoding import Value, decode
from ca.errors import EncodingError
from rossec.authority.keyservice import messages
from rossec.errors import KeyMessageRefused

MAX_FRAME: Final = 128 * 1024
LIFETIME: Final = 8 * 3600  # seconds of a session
IDLE: Final = 30 * 60  # seconds without use after which a session ends
ON_THE_WALL: Final = 90 * 86400  # seconds of a session that can only look, which nobody touches
READY, CERTIFICATE = "ready", "certificate"
WORDS: Final[Mapping[str, tuple[type, ...]]] = {
    READY: (),  # from the web process: it serves
    CERTIFICATE: (bytes,),  # from the supervisor: key and chain, PEM, for connections from now on
}


@dataclass(frozen=True)
class WebSettings:
    """What the web process was started with."""

    domain: str
    origins: tuple[str, ...]  # as browsers send them (RFC 6454); of the first are links and passkeys
    users: frozenset[int] | None = None  # whose programs on this host may connect; None: not on localhost
    hsts: bool = False  # whether browsers shall insist on https for this name
    read_only: bool = False  # whether pages only show
    lifetime: int = LIFETIME  # of sessions, in seconds
    idle: int = IDLE
    proxy_users: frozenset[int] = frozenset()  # whose programs may connect at a unix socket, as a proxy

    @property
    def origin(self) -> str:
        return self.origins[0]

    @property
    def rp_id(self) -> str:
        return urlsplit(self.origin).hostname or ""

    @property
    def hosts(self) -> frozenset[str]:
        return frozenset(urlsplit(origin).netloc for origin in self.origins)


def write_settings(settings: WebSettings) -> str:
    """Settings as text, for the web process's command line: nothing in them is secret."""
    fields = asdict(settings)
    fields["users"] = None if settings.users is None else sorted(settings.users)
    fields["proxy_users"] = sorted(settings.proxy_users)
    return json.dumps(fields)


def read_settings(text: str) -> WebSettings:
    fields = json.loads(text)
    fields["origins"] = tuple(fields["origins"])
    fields["users"] = None if fields["users"] is None else frozenset(fields["users"])
    fields["proxy_users"] = frozenset(fields["proxy_users"])
    return WebSettings(**fields)


class ControlMessage(NamedTuple):
    word: str
    arguments: tuple[Value, ...] = ()


def write(word: ControlMessage) -> bytes:
    return messages.frame([word.word, *word.arguments])


frame_size: Final = partial(messages.frame_size, limit=MAX_FRAME)


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
