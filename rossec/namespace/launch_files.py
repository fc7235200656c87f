"""A launch file and those it includes from its own directory: read, named, written beside OUT.

Only `$(dirname)/FILE` is followed: a file of another directory belongs to somebody else, and what
`$(find package)` or an argument give is known to roslaunch alone. What is not followed is said
(`notes`), since metadata in there would have no effect. No file is overwritten, and nothing is
written before everything has its names.
"""

import re
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

from rossec import files
from rossec.errors import ConfigurationError, MetadataRefused, RossecError
from rossec.namespace.launch_edit import Edit, NamedNode, NameOf, apply, edits, named
from rossec.namespace.launch_scan import Include, Launch, scan
from rossec.naming.documents import MAX_INPUT

MAX_FILES: Final = 32
MODE: Final = 0o644  # a launch file is for every user of the host, as the source is
_BESIDE: Final = re.compile(r"\$\(dirname\)/([A-Za-z0-9_.-]+)")
_DIRNAME: Final = b"$(dirname)"


@dataclass
class LaunchFiles:
    """What is to be written: `written` by path; `nodes` are those with new names."""

    written: dict[Path, bytes] = field(default_factory=dict)
    nodes: list[NamedNode] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def write(self) -> None:
        """Write the files, all or none.

        Raises:
            ConfigurationError: one exists already.
            NotWritten: the disk refused one.
        """
        for path in self.written:
            if path.exists() or path.is_symlink():
                raise ConfigurationError(
                    f"{path} exists and is not overwritten", "remove it, or name a new file: --out"
                )
        with ExitStack() as undo:
            for path, data in self.written.items():
                files.create(path, data, MODE)
                undo.callback(path.unlink, missing_ok=True)
            undo.pop_all()


def read(source: Path, out: Path, name_of: NameOf) -> LaunchFiles:
    """The transformed files for `source`, which is to be written to `out`.

    Raises:
        RossecError: a file cannot be read, or there is no name; it names file and line.
    """
    reader = _Reader(source.absolute().parent, out, name_of)
    reader.add(source, out)
    found = reader.found
    twice = Counter(node.name for node in found.nodes)
    for name in (name for name, count in twice.items() if count > 1):
        raise MetadataRefused(f"the rules name {twice[name]} nodes {name}", "see the files' lines")
    counts = Counter(name for node in found.nodes for name in {e.name for e in node.entries})
    found.notes += [
        f"{count} nodes get the name {name}: do they mean the same topic?"
        for name, count in counts.items()
        if count > 1
    ]
    return found


class _Reader:
    """The files in the directory of the first one."""

    def __init__(self, directory: Path, out: Path, name_of: NameOf) -> None:
        self.found = LaunchFiles()
        self._directory = directory
        self._out = out
        self._name_of = name_of
        self._targets: dict[Path, Path] = {}

    def add(self, source: Path, target: Path) -> None:
        """Read a file that is to be written to `target`, and what it includes."""
        if len(self._targets) == MAX_FILES:
            raise MetadataRefused(f"more than {MAX_FILES} launch files")
        if target in self._targets.values():
            raise ConfigurationError(f"two files would become {target}", "name another --out")
        self._targets[source.absolute()] = target
        try:
            data = files.read(source, MAX_INPUT)
            launch = scan(data)
            nodes = named(launch, self._name_of)
        except RossecError as error:
            raise type(error)(f"{source}: {error}", error.hint) from error
        self.found.nodes += nodes
        self._check_directory(source, target, data, launch)
        changes = edits(data, launch, nodes)
        for include in launch.includes:
            changes += self._include(source, include)
        self.found.written[target] = apply(data, changes)

    def _include(self, source: Path, include: Include) -> list[Edit]:
        """Follow an include; returns what becomes of it."""
        match = _BESIDE.fullmatch(include.file)
        beside = None if match is None else self._directory / match[1]
        if match is None or beside is None or not beside.is_file():
            self.found.notes.append(
                f"{source}: line {include.line}: {include.file} is not followed: metadata in it "
                "have no effect; transform it, and include what that gives"
            )
            return []
        if beside not in self._targets:
            self.add(beside, self._out.with_name(f"{self._out.stem}.{match[1]}"))
        written = f"$(dirname)/{self._targets[beside].name}"
        return [Edit(include.value, quoteattr(written)[1:-1].encode())]

    def _check_directory(self, source: Path, target: Path, data: bytes, launch: Launch) -> None:
        followed = sum(_BESIDE.fullmatch(include.file) is not None for include in launch.includes)
        moved = target.absolute().parent != self._directory
        if moved and data.count(_DIRNAME) > followed:
            self.found.notes.append(
                f"{source} names files beside it by $(dirname): in the directory of {target} they "
                "may be missing"
            )
