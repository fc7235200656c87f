"""The process that decodes pictures of browsers (`python -I -m rossec.console.scanning`).

Frames come on standard input, answers leave on standard output.
"""

import logging
import os
import resource
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, TypeAlias

from ca.encoding import decode, encode
from ca.enrollment.qr import MAX_TEXT
from ca.errors import EncodingError
from rossec.enrollment import scanner
from rossec.errors import ConfigurationError, KeyMessageRefused
from rossec.host import sandbox
from rossec.host.confinement import lower_limits

HEAD: Final = 4
MAX_PICTURE: Final = 256 * 1024
MAX_ANSWER: Final = 4096


class Found(NamedTuple):
    text: str  # of the code in a picture; empty: there is none


class Unreadable(NamedTuple):
    message: str
    hint: str


Answer: TypeAlias = Found | Unreadable


def frame(body: bytes) -> bytes:
    return len(body).to_bytes(HEAD) + body


def size(head: bytes, limit: int) -> int:
    found = int.from_bytes(head)
    if not 0 < found <= limit:
        raise KeyMessageRefused(f"a picture's frame of {found} bytes where {limit} are allowed")
    return found


answer_size: Final = partial(size, limit=MAX_ANSWER)


def write_answer(answer: Answer) -> bytes:
    return frame(encode([0 if isinstance(answer, Found) else 1, *answer]))


def read_answer(body: bytes) -> Answer:
    try:
        match decode(body, limit=MAX_ANSWER):
            case [0, str() as text] if len(text) <= MAX_TEXT:
                return Found(text)
            case [1, str() as message, str() as hint]:
                return Unreadable(message, hint)
            case _:
                pass
    except EncodingError as error:
        raise KeyMessageRefused(f"a scanner's answer that is malformed: {error}") from error
    raise KeyMessageRefused("a scanner's answer of another form")


SEVERAL: Final = Unreadable("there are several codes in the picture", "show one of them alone")
_LARGE: Final = Unreadable("the picture takes more memory than allowed", scanner.CLOSER)
_NICE: Final = 10  # a camera is no reason to slow a robot down
_LIMITS: Final = {
    resource.RLIMIT_AS: scanner.MEMORY,
    resource.RLIMIT_CORE: 0,
    resource.RLIMIT_FSIZE: 0,
    resource.RLIMIT_NOFILE: 16,
    resource.RLIMIT_NPROC: 0,
}
_log = logging.getLogger("rossec.console.scanner")


def main() -> None:
    logging.basicConfig(level=logging.WARNING)
    sandbox.protect_memory()
    answer(b"")  # loads the libraries
    confine()
    serve(sys.stdin.buffer, sys.stdout.buffer, answer)


def confine() -> None:
    # Pictures are untrusted, and the libraries that decode them are written in C: this process opens no file,
    # starts no other one, writes none, and has limits on memory. The time is its supervisor's to limit.
    os.nice(_NICE)
    lower_limits(_LIMITS)
    try:
        sandbox.read_only(map(Path, ("/usr/lib", "/proc/self", *filter(None, sys.path))))
    except OSError as error:
        _log.warning("the scanner can read the files of its user: %s", error)


def serve(source: BinaryIO, sink: BinaryIO, read: Callable[[bytes], Answer]) -> None:
    while len(head := source.read(HEAD)) == HEAD:
        picture = source.read(size(head, MAX_PICTURE))
        sink.write(write_answer(read(picture)))
        sink.flush()


def answer(picture: bytes) -> Answer:
    try:
        texts = scanner.texts(picture)
    except ConfigurationError as error:
        return Unreadable(str(error), error.hint)
    except MemoryError:
        return _LARGE
    return SEVERAL if len(texts) > 1 else Found(texts[0] if texts else "")


if __name__ == "__main__":
    main()
