"""`completion.json` in ROSSEC_HOME: the names that the last look at the graph showed.

Written after a command has asked the master with an identity, so that Tab asks nobody. Readable by
its owner only: what a node may see of the graph is not for every user of the host.
"""

import contextlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from ca.errors import HintedError
from ca.keys import ownership
from rossec.cli.completion.words import MAX_WORDS, is_offered

NAME: Final = "completion.json"
TOPIC: Final = "topic"
SERVICE: Final = "service"
NODE: Final = "node"
TYPE: Final = "type"
_MAX: Final = 1024 * 1024


def keep(home: Path, master: str, names: Mapping[str, Iterable[str]]) -> None:
    """Keep the names of each kind, as the master at the URI `master` gave them.

    A home that cannot be written is no failure of the command that looked.
    """
    from rossec import files  # noqa: PLC0415 - not needed to read

    kept = {kind: [*filter(is_offered, found)][:MAX_WORDS] for kind, found in names.items()}
    data = json.dumps({"master": master, "names": kept}).encode()
    with contextlib.suppress(OSError, HintedError):
        files.replace(home / NAME, data, 0o600)


def read(home: Path, master: str, kind: str) -> list[object]:
    """The names of a kind; none if the last look was at another master."""
    try:
        with os.fdopen(ownership.open_trusted(home / NAME), "rb") as stream:
            found = json.loads(stream.read(_MAX))
    except (OSError, HintedError, ValueError):
        return []
    match found:
        case {"master": str() as uri, "names": {**names}} if uri == master:
            words = names.get(kind)
            return words if isinstance(words, list) else []
    return []
