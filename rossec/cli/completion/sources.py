"""The names that completion offers, read from files of ROSSEC_HOME and of ROS. A shell.

Nothing here asks a person or a network, writes, or reads a key. What is missing, damaged, or could
be changed by another user gives no names. The authority's record is read by SQL of its own, since
`ca.store` takes too long to import (as `rossec.clock` does); it is opened for reading, and never
waited for.
"""

import contextlib
import importlib.util
import os
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from ca.errors import HintedError
from ca.keys import ownership
from rossec.cli.completion import values

RIGHTS: Final = ("admin", "call", "graph", "param-get", "param-set", "provide", "publish", "subscribe")
_MAX_POLICY: Final = 1024 * 1024
_NAME: Final = re.compile(r"""(?<![\w/*.:-])(?:[a-z0-9._-]+:)?(?:/[A-Za-z]\w*)+(?![\w/*])""", re.ASCII)
_TYPE: Final = re.compile(r"^    '(\w+)/msg/(\w+)'", re.ASCII | re.MULTILINE)
_SHORT: Final = 8  # hexadecimal digits; commands take the beginning of an identifier

_RECORD: Final = {
    "node": "SELECT name FROM certificate WHERE not_after > :now"
    " AND thumbprint NOT IN (SELECT entry FROM revocation)",
    "thing": "SELECT name FROM thing WHERE expires > :now AND id NOT IN (SELECT entry FROM revocation)",
    "grant": "SELECT id FROM grant_ WHERE expires > :now AND id NOT IN (SELECT entry FROM revocation)",
    "invitation": "SELECT id FROM invitation WHERE expires > :now"
    " AND id NOT IN (SELECT invitation FROM invitation_end)",
    "request": "SELECT digest FROM csr WHERE state = 'pending'",
    "grant request": "SELECT id FROM grant_request WHERE id NOT IN (SELECT request FROM decision)",
    "phone": "SELECT name FROM passkey WHERE id NOT IN (SELECT passkey FROM passkey_end)",
    "domain": "SELECT label FROM foreign_domain WHERE number NOT IN (SELECT number FROM foreign_domain_end)",
}


class Sources:
    """Where the names of one command line come from.

    `home` is ROSSEC_HOME; `variables` the process environment.
    """

    def __init__(self, home: Path, variables: Mapping[str, str]) -> None:
        self._home = home
        self._variables = variables

    def own_nodes(self) -> Iterator[object]:
        for entry in _entries(self._home / "nodes"):
            yield f"/{entry.replace('.', '/')}"

    def recorded(self, kind: str) -> Iterator[object]:
        path = self._home / "ca" / "ca.db"
        with contextlib.suppress(OSError, HintedError, sqlite3.Error):
            # A record that another user could have written is not opened: SQLite parses it.
            ownership.check_trusted(path)
            # Without writers' files SQLite would make some, also to read.
            busy = path.with_name(f"{path.name}-wal").exists()
            uri = f"{path.absolute().as_uri()}?{'mode=ro' if busy else 'immutable=1'}"
            with contextlib.closing(sqlite3.connect(uri, timeout=0, uri=True)) as db:
                # A schema may have triggers and views with functions: none is trusted to run.
                db.execute("PRAGMA trusted_schema = OFF")
                for (found,) in db.execute(_RECORD[kind], {"now": int(time.time())}):
                    yield found.hex()[:_SHORT] if isinstance(found, bytes) else found

    def seen(self, kind: str) -> Iterator[object]:
        master = self._variables.get("ROS_MASTER_URI", "")
        yield from values.read(self._home, master, kind)

    def written(self) -> Iterator[object]:
        with contextlib.suppress(OSError, HintedError):
            path = self._home / "ca" / "policy.yaml"
            with os.fdopen(ownership.open_trusted(path, link=True), "rb") as stream:
                text = stream.read(_MAX_POLICY).decode(errors="replace")
            for line in text.splitlines():
                yield from _NAME.findall(line.partition("#")[0])

    def rights(self) -> Iterator[object]:
        yield from RIGHTS

    def held_grants(self) -> Iterator[object]:
        for node in _entries(self._home / "nodes"):
            for entry in _entries(self._home / "nodes" / node / "grants"):
                yield entry.removesuffix(".grant")[:_SHORT] if entry.endswith(".grant") else None

    def types(self, folder: str) -> Iterator[object]:
        given = self._variables.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
        places = dict.fromkeys([*given, "/opt/ros/noetic/share", "/usr/share"])
        for share in (Path(path) for path in places if path[:1] == "/"):
            for package in _entries(share):
                for entry in _entries(share / package / folder):
                    if entry.endswith(f".{folder}"):
                        yield f"{package}/{entry.removesuffix(f'.{folder}')}"

    def known_types(self) -> Iterator[object]:
        found = importlib.util.find_spec("rosbags")
        for place in (found.submodule_search_locations or []) if found else []:
            with contextlib.suppress(OSError):
                text = Path(place, "typesys", "stores", "ros1_noetic.py").read_text(errors="replace")
                yield from map("/".join, _TYPE.findall(text))


def _entries(directory: Path) -> list[str]:
    try:
        return os.listdir(directory)  # noqa: PTH208 - thousands of them, as plain text
    except OSError:
        return []
