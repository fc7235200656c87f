"""A manual page for `rossec` and for each noun with its verbs, from what click knows of them. Pure.

`man rossec ca` finds the page `rossec-ca`: man-db joins two words. A page says what `--help` says,
so it cannot be wrong alone.
"""

import inspect
from collections.abc import Iterator
from typing import Final

import click

from rossec.cli.manual.roff import (
    bold,
    escape,
    italic,
    item,
    paragraph,
    section,
    subsection,
    title,
    verbatim,
)
from rossec.cli.shared.lazy import LazyCommand

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


def pages(group: click.Group, version: str) -> dict[str, str]:
    """The text of each page by its file name (`rossec-ca.1`)."""
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
    """A command and all below it, by their words."""
    yield path, command
    if isinstance(command, click.Group):
        for name, each in sorted(command.commands.items()):
            yield from _below(f"{path} {name}", _loaded(each))


def _runs(command: click.Command) -> bool:
    """Whether it does something without a verb."""
    return not isinstance(command, click.Group) or command.invoke_without_command


def _head(name: str, command: click.Command, version: str) -> list[str]:
    lines = [title(name, f"{PROGRAM} {version}"), section("NAME")]
    return [*lines, rf"{escape(name)} \- {escape(_summary(command))}"]


def _summary(command: click.Command) -> str:
    """The first sentence of the help text, on one line."""
    first = " ".join((command.help or "").split("\n\n")[0].split())
    return first.partition(". ")[0].rstrip(".")


def _context(path: str, command: click.Command) -> click.Context:
    return click.Context(command, info_name=path)


def _synopsis(path: str, command: click.Command) -> list[str]:
    context = _context(path, command)
    pieces = command.collect_usage_pieces(context)
    if not _option_records(command):
        pieces.remove(context.command.options_metavar or "")
    return [" ".join([bold(path), *map(italic, pieces)])]


def _text(command: click.Command) -> list[str]:
    """The help text; a paragraph that begins with \\b keeps its lines, as in click."""
    lines: list[str] = []
    text = inspect.cleandoc(command.help or "").partition("\f")[0]
    for part in filter(None, (each.strip("\n") for each in text.split("\n\n"))):
        first, _, rest = part.partition("\n")
        lines += verbatim(rest.split("\n")) if first.strip() == "\b" else paragraph(part)
    return lines[1:] if lines[:1] == [".PP"] else lines  # the heading begins a paragraph already


def _options(command: click.Command) -> list[str]:
    records = _records(command)
    return [section("OPTIONS"), *records] if records else []


def _records(command: click.Command) -> list[str]:
    return [line for names, text in _option_records(command) for line in item(bold(names), text)]


def _option_records(command: click.Command) -> list[tuple[str, str]]:
    """The options but for --help, and what they mean."""
    context = _context(PROGRAM, command)
    options = (each for each in command.params if isinstance(each, click.Option))
    return [record for each in options if (record := each.get_help_record(context)) is not None]
