"""What a build makes of the commands: a manual page for `rossec` and for each noun, and the outlines.

`man rossec ca` finds the page `rossec-ca`: man-db joins two words. A page says what `--help` says, so
it cannot be wrong alone. It is roff as man(7) has it: the few macros of our pages, and text that can
hold any character. `hatch_build.py` puts it all into the wheel.
"""

import inspect
import json
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import click

from rossec import __version__
from rossec.cli.completion.values import Outline, outline_of
from rossec.cli.main import rossec
from rossec.cli.shared.context import LazyCommand
from rossec.terminal import say

# A hyphen is a minus, so that an option can be copied from the page; accents and quotes are the ASCII
# characters they are (groff_char(7), "Basic Latin").
_ESCAPED: Final = {
    "\\": r"\e",
    "-": r"\-",
    "^": r"\(ha",
    "~": r"\(ti",
    "`": r"\(ga",
    "'": r"\(aq",
    '"': r"\(dq",
}
_SPECIAL: Final = re.compile(r"""[\\^~`'"-]|[^\x20-\x7e]""")
_FONT: Final = {"B": r"\fB", "I": r"\fI"}
PROGRAM: Final = "rossec"
_STATUS: Final = {
    "0": "done",
    "1": "refused",
    "2": "wrong usage",
    "3": "done here but not delivered: the master or the node was out of reach",
    "4": "done, but grants made by hand allow what the policy denies",
    "5": "waiting for the authority or for a person: run it again",
    "130": "interrupted",
}
_ENVIRONMENT: Final = {
    "ROSSEC_HOME": "the directory of all files, ~/.local/share/rossec by default",
    "ROSSEC_MASTER": "the certified name of the own master, /master by default",
    "ROS_MASTER_URI": "where the master is, http://localhost:11311 by default",
    "NO_COLOR": "if it is set and not empty, nothing is coloured",
}


def make(group: click.Group, version: str, directory: Path) -> tuple[list[Path], Path]:
    """Write the pages below `man1`, and the outlines; both are the same for the same commands."""
    folder = directory / "man1"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in pages(group, version).items():
        written.append(folder / name)
        written[-1].write_text(text)
    table = directory / "outlines.json"
    table.write_text(json.dumps({"outlines": dict(outlines(group))}, sort_keys=True))
    return written, table


def pages(group: click.Group, version: str) -> dict[str, str]:
    nouns = {name: _loaded(each) for name, each in sorted(group.commands.items())}
    made = {f"{PROGRAM}.1": _program(group, nouns, version)}
    for name, command in nouns.items():
        made[f"{PROGRAM}-{name}.1"] = _noun(name, command, version)
    return {name: "\n".join(lines) + "\n" for name, lines in made.items()}


def _loaded(command: click.Command) -> click.Command:
    return command.load() if isinstance(command, LazyCommand) else command


def _program(group: click.Group, nouns: dict[str, click.Command], version: str) -> list[str]:
    lines = _head(PROGRAM, group, version)
    lines += [section("SYNOPSIS"), *_synopsis(PROGRAM, group)]
    lines += [section("DESCRIPTION"), *_text(group), *_options(group)]
    lines.append(section("COMMANDS"))
    for name, command in nouns.items():
        lines += item(rf"\fB{PROGRAM}\-{escape(name)}\fR(1)", _summary(command))
    for heading, rows in (("EXIT STATUS", _STATUS), ("ENVIRONMENT", _ENVIRONMENT)):
        lines.append(section(heading))
        for term, meaning in rows.items():
            lines += item(bold(term), meaning)
    return lines


def _head(name: str, command: click.Command, version: str) -> list[str]:
    lines = [title(name, f"{PROGRAM} {version}"), section("NAME")]
    return [*lines, rf"{escape(name)} \- {escape(_summary(command))}"]


def title(name: str, source: str) -> str:
    """The first line of the page `name` of section 1. It has no date: a build can be repeated."""
    return f'.TH "{escape(name.upper())}" 1 "" "{escape(source)}" "rossec manual"'


def escape(text: str) -> str:
    """`text` on one line, as roff prints it; a control character is a space."""
    line = _SPECIAL.sub(_character, text)
    return rf"\&{line}" if line[:1] == "." else line


def _character(match: re.Match[str]) -> str:
    found = match[0]
    if found in _ESCAPED:
        return _ESCAPED[found]
    return rf"\[u{ord(found):04X}]" if found.isprintable() else " "


def section(heading: str) -> str:
    return f'.SH "{escape(heading)}"'


def _summary(command: click.Command) -> str:
    first = " ".join((command.help or "").split("\n\n")[0].split())
    return first.partition(". ")[0].rstrip(".")


def _synopsis(path: str, command: click.Command) -> list[str]:
    context = _context(path, command)
    pieces = command.collect_usage_pieces(context)
    if not _option_records(command):
        pieces.remove(context.command.options_metavar or "")
    return [" ".join([bold(path), *map(italic, pieces)])]


def _context(path: str, command: click.Command) -> click.Context:
    return click.Context(command, info_name=path)


def _option_records(command: click.Command) -> list[tuple[str, str]]:
    context = _context(PROGRAM, command)
    options = (each for each in command.params if isinstance(each, click.Option))
    return [record for each in options if (record := each.get_help_record(context)) is not None]


def bold(text: str) -> str:
    return rf"\fB{escape(text)}\fR"


def italic(text: str) -> str:
    return rf"\fI{escape(text)}\fR"


def _text(command: click.Command) -> list[str]:
    lines: list[str] = []
    text = inspect.cleandoc(command.help or "").partition("\f")[0]
    for part in filter(None, (each.strip("\n") for each in text.split("\n\n"))):
        first, _, rest = part.partition("\n")
        lines += verbatim(rest.split("\n")) if first.strip() == "\b" else paragraph(part)
    return lines[1:] if lines[:1] == [".PP"] else lines  # the heading begins a paragraph already


def verbatim(lines: Iterable[str]) -> list[str]:
    return [".PP", ".RS 4", ".nf", *(escape(line.rstrip()) or r"\&" for line in lines), ".fi", ".RE"]


def paragraph(text: str) -> list[str]:
    return [".PP", escape(" ".join(text.split()))]


def _options(command: click.Command) -> list[str]:
    records = _records(command)
    return [section("OPTIONS"), *records] if records else []


def _records(command: click.Command) -> list[str]:
    return [line for names, text in _option_records(command) for line in item(bold(names), text)]


def item(term: str, text: str) -> list[str]:
    return [".TP", term, escape(" ".join(text.split())) or r"\&"]


def _noun(name: str, command: click.Command, version: str) -> list[str]:
    lines = _head(f"{PROGRAM}-{name}", command, version)
    found = [*_below(f"{PROGRAM} {name}", command)]
    lines.append(section("SYNOPSIS"))
    for number, (path, each) in enumerate(pair for pair in found if _runs(pair[1])):
        lines += [*([".br"] if number else []), *_synopsis(path, each)]
    lines += [section("DESCRIPTION"), *_text(command), *_options(command)]
    if len(found) > 1:
        lines.append(section("COMMANDS"))
    for path, each in found[1:]:
        lines += [subsection(path), *_text(each), *_records(each)]
    return [*lines, section("SEE ALSO"), rf"\fB{PROGRAM}\fR(1)"]


def _below(path: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    yield path, command
    if isinstance(command, click.Group):
        for name, each in sorted(command.commands.items()):
            yield from _below(f"{path} {name}", _loaded(each))


def _runs(command: click.Command) -> bool:
    return not isinstance(command, click.Group) or command.invoke_without_command


def subsection(heading: str) -> str:
    return f'.SS "{escape(heading)}"'


def outlines(group: click.Group) -> Iterator[tuple[str, Outline]]:
    for listed in group.commands.values():
        if isinstance(listed, LazyCommand):
            command = listed.load()
            yield listed.place, outline_of(command)
            if isinstance(command, click.Group):
                yield from outlines(command)


def main() -> None:
    written, _ = make(rossec, __version__, Path(sys.argv[1]))
    say(f"{len(written)} pages in {written[0].parent}")


if __name__ == "__main__":
    main()
