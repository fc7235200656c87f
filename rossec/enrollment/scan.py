"""Read an enrollment code from a picture: a photograph, a screenshot, a frame of a camera.

A shell. The picture is decoded in a process of its own (`rossec.enrollment.scanner`), with a time
limit; no answer, or anything but a few texts, means that there is no code.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO, Final

from rossec.enrollment.scanner import CLOSER, MAX_FILE, SECONDS
from rossec.errors import ConfigurationError

SCANNER: Final = (sys.executable, "-I", "-m", "rossec.enrollment.scanner")


def code_in_file(path: Path, stdin: BinaryIO) -> str:
    """The text of the one code in a picture; `-` is standard input.

    Raises:
        ConfigurationError: not a picture, too large, not exactly one code, or the extra is missing.
    """
    if str(path) == "-":
        return code_in(stdin.read(MAX_FILE + 1))
    with path.open("rb") as file:
        return code_in(file.read(MAX_FILE + 1))


def code_in(data: bytes) -> str:
    """As `code_in_file`, for the bytes of the picture."""
    match _texts(data):
        case [text]:
            return text
        case []:
            raise ConfigurationError("there is no rossec code in the picture", CLOSER)
        case found:
            raise ConfigurationError(
                f"there are {len(found)} codes in the picture", "show one of them alone"
            )


def _texts(data: bytes) -> list[str]:
    if len(data) > MAX_FILE:
        raise ConfigurationError(f"the picture has more than {MAX_FILE} bytes", CLOSER)
    try:
        done = subprocess.run(  # noqa: S603 - our own program, by its full path
            SCANNER, input=data, capture_output=True, timeout=3 * SECONDS, check=True
        )
        answer = json.loads(done.stdout)
    except (subprocess.SubprocessError, ValueError) as error:
        raise ConfigurationError("reading the picture took too long, or failed", CLOSER) from error
    if "error" in answer:
        raise ConfigurationError(answer["error"], answer["hint"])
    return [str(text) for text in answer["texts"]]
