"""The process that decodes pictures of browsers (`python -I -m rossec.console.scanning.worker`).

Frames come on standard input, answers leave on standard output. Pictures are untrusted, and the
libraries that decode them are written in C: this process opens no file, starts no other one, writes
none, and has limits on memory. The time for a picture is its supervisor's to limit.
"""

import logging
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from rossec.console.scanning import frames
from rossec.console.scanning.frames import Found, Unreadable
from rossec.enrollment import scanner
from rossec.errors import ConfigurationError
from rossec.operation import landlock
from rossec.operation.process_memory import protect_memory

SEVERAL: Final = Unreadable("there are several codes in the picture", "show one of them alone")
_LARGE: Final = Unreadable("the picture takes more memory than allowed", scanner.CLOSER)
_FILES: Final = 16  # descriptors
_NICE: Final = 10  # a camera is no reason to slow a robot down
_log = logging.getLogger("rossec.console.scanner")


def answer(picture: bytes) -> Found | Unreadable:
    """The one code in a picture."""
    try:
        texts = scanner.texts(picture)
    except ConfigurationError as error:
        return Unreadable(str(error), error.hint)
    except MemoryError:
        return _LARGE
    return SEVERAL if len(texts) > 1 else Found(texts[0] if texts else "")


def serve(source: BinaryIO, sink: BinaryIO, read: Callable[[bytes], Found | Unreadable]) -> None:
    """Answer pictures until there are no more.

    Raises:
        KeyMessageRefused: a frame that is too long.
    """
    while len(head := source.read(frames.HEAD)) == frames.HEAD:
        picture = source.read(frames.size(head, frames.MAX_PICTURE))
        sink.write(frames.write_answer(read(picture)))
        sink.flush()


def confine() -> None:
    """Give up everything but memory and the two descriptors; the libraries are loaded before."""
    os.nice(_NICE)
    for what, most in (
        (resource.RLIMIT_AS, scanner.MEMORY),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, _FILES),
        (resource.RLIMIT_NPROC, 0),
    ):
        _, hard = resource.getrlimit(what)
        bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (bound, bound))
    try:
        landlock.read_only(map(Path, ("/usr/lib", "/proc/self", *filter(None, sys.path))))
    except OSError as error:
        _log.warning("the scanner can read the files of its user: %s", error)


def main() -> None:
    """Serve standard input, confined."""
    logging.basicConfig(level=logging.WARNING)
    protect_memory()
    answer(b"")  # loads the libraries
    confine()
    serve(sys.stdin.buffer, sys.stdout.buffer, answer)


if __name__ == "__main__":
    main()
