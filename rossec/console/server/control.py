"""Between the supervisor and its web process: frames over a socketpair. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR: a word of
`WORDS` and its arguments. Whichever side ends, the other sees the end of the stream.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError
from rossec.authority.keyservice.messages import HEAD
from rossec.errors import KeyMessageRefused

MAX_FRAME: Final = 128 * 1024

READY, CERTIFICATE = "ready", "certificate"
WORDS: Final[Mapping[str, tuple[type, ...]]] = {
    READY: (),  # from the web process: it serves
    CERTIFICATE: (bytes,),  # from the supervisor: key and chain, PEM, for connections from now on
}


class ControlMessage(NamedTuple):
    """A word and its arguments, whose types are those of `WORDS`."""

    word: str
    arguments: tuple[Value, ...] = ()


def write(word: ControlMessage) -> bytes:
    """The frame of a word."""
    body = encode([word.word, *word.arguments])
    return len(body).to_bytes(HEAD) + body


def read(body: bytes) -> ControlMessage:
    """Read the body of a frame.

    Raises:
        KeyMessageRefused: malformed, or not in the table.
    """
    try:
        value = decode(body, limit=MAX_FRAME)
    except EncodingError as error:
        raise KeyMessageRefused(f"a word that is malformed: {error}") from error
    match value:
        case [str() as word, *arguments] if word in WORDS:
            if tuple(map(type, arguments)) == WORDS[word]:
                return ControlMessage(word, tuple(arguments))
    raise KeyMessageRefused("a word that is not in the table")
