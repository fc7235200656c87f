"""The build makes manual pages and outlines of the commands, and puts them into the wheel.

They are the same in every build of the same sources. An editable install has none: there outlines
are kept as they are needed, and `make man` writes the pages.
"""

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class MadeOfCommands(BuildHookInterface):
    """Imports the command line from the sources that are built."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make the files, and name them for the wheel."""
        self.made = Path(tempfile.mkdtemp())
        if version != "standard":
            return
        sys.path.insert(0, self.root)
        sys.dont_write_bytecode = True
        from rossec.cli.main import rossec  # noqa: PLC0415 - they are found only now
        from rossec.cli.manual import make  # noqa: PLC0415 - likewise

        pages, table = make(rossec, self.metadata.version, self.made)
        build_data["force_include"][str(table)] = "rossec/cli/completion/outlines.json"
        build_data["shared_data"] |= {str(page): f"share/man/man1/{page.name}" for page in pages}

    def finalize(self, *_build: object) -> None:
        """Leave nothing behind."""
        shutil.rmtree(self.made)
