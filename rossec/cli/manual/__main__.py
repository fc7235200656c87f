"""`python -m rossec.cli.manual DIRECTORY`: write the manual pages there (`make man`)."""

import sys
from importlib.metadata import version
from pathlib import Path

from rossec.cli.main import rossec
from rossec.cli.manual.pages import make
from rossec.terminal import say


def main() -> None:
    written, _ = make(rossec, version("rossec"), Path(sys.argv[1]))
    say(f"{len(written)} pages in {written[0].parent}")


if __name__ == "__main__":
    main()
