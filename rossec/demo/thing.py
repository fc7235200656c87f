"""The demo's thing: `examples/border/thing.py`, as it is, whose lines are reported.

Run as `python -I -m rossec.demo.thing DIRECTORY ARGUMENTS...`; one JSON object a line on stdout. In
an installed package the example lies beside this file.
"""

import contextlib
import io
import json
import os
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, TextIO

from rossec.errors import ConfigurationError

NAME: Final = "thing.py"
_HERE: Final = Path(__file__).parent
_PLACES: Final = (_HERE / "border", _HERE.parents[1] / "examples" / "border")


class Reporter(io.TextIOBase):
    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._line = ""

    def write(self, text: str) -> int:
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            self._out.write(json.dumps({"said": line}) + "\n")
        return len(text)

    def flush(self) -> None:
        self._out.flush()


def find(places: Sequence[Path] = _PLACES) -> Path:
    for place in places:
        if (place / NAME).is_file():
            return place / NAME
    raise ConfigurationError("the example of a thing is missing", "install rossec again")


def main(directory: str, arguments: Sequence[str]) -> None:
    program = find()
    os.chdir(directory)
    sys.path.insert(0, str(program.parent))  # what it imports lies beside it
    sys.argv = [str(program), *arguments]
    with contextlib.redirect_stdout(Reporter(sys.stdout)):
        runpy.run_path(str(program), run_name="__main__")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
