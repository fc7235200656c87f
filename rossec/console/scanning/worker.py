"""The process that decodes pictures of browsers (`python -I -m rossec.console.scanning.worker`).

Frames come on standard input, answers leave on standard output.
"""

import logging
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from rossec.console.scanning import frames
from rossec.enrollment import scanner
from rossec.errors import ConfigurationError
from rossec.host import sandbox
from rossec.host.confinement import lower_limits

SEVERAL: Final = frames.Unreadable("there are several codes in the picture", "show one of them alone")
_LARGE: Final = frames.Unreadable("the picture takes more memory than allowed", scanner.CLOSER)
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


def serve(source: BinaryIO, sink: BinaryIO, read: Callable[[bytes], frames.Answer]) -> None:
    while len(head := source.read(frames.HEAD)) == frames.HEAD:
        picture = source.read(frames.size(head, frames.MAX_PICTURE))
        sink.write(frames.write_answer(read(picture)))
        sink.flush()


def answer(picture: bytes) -> frames.Answer:
    try:
        texts = scanner.texts(picture)
    except ConfigurationError as error:
        return frames.Unreadable(str(error), error.hint)
    except MemoryError:
        return _LARGE
    return SEVERAL if len(texts) > 1 else frames.Found(texts[0] if texts else "")


if __name__ == "__main__":
    main()
