"""Options that commands share, results as JSON, several names in one command, and work that takes long.

Keys of results are documented in docs/spec/results.md.
"""

import functools
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, TypeVar

import click

from ca.errors import HintedError, RecordUnusable
from rossec.cli.shared.context import Duration
from rossec.errors import ConfigurationError
from rossec.terminal import FACTS, TEMPORARY, fail, printable, say, say_json, say_secret, to_json

MAX_PEM: Final = 64 * 1024
FILE: Final = click.Path(path_type=Path, exists=True, dir_okay=False)
NEW_FILE: Final = click.Path(path_type=Path, dir_okay=False)
FOLDER: Final = click.Path(path_type=Path, file_okay=False)
OLD_FOLDER: Final = click.Path(path_type=Path, exists=True, file_okay=False)
PATH: Final = click.Path(path_type=Path)
_F = TypeVar("_F", bound=Callable[..., Any])


def option(flags: str, text: str, **settings: Any) -> Callable[[_F], _F]:
    """An option, as `"--list=FILE newest"`: its flags, what help calls its value, the command's argument."""
    value = re.search(r"=(\S+)", flags)
    if value is not None:
        flags, settings["metavar"] = flags.replace(value[0], "", 1), value[1]
    return click.option(*flags.split(), help=text, **settings)


def flag(flags: str, text: str, **settings: Any) -> Callable[[_F], _F]:
    """An option without a value."""
    return option(flags, text, is_flag=True, **settings)


def duration(flags: str, text: str, *, days: int, default: str | None) -> Callable[[_F], _F]:
    return option(flags, text, type=Duration(days), default=default, show_default=True)


policy = option(
    "--policy policy_path", "this policy, instead of ca/policy.yaml in ROSSEC_HOME", type=NEW_FILE
)
master_uri = option(
    "--master=URI master_uri", "master to notify, instead of ROS_MASTER_URI; discover: finds it"
)
image = option(
    "--image",
    "read the code from this picture; - is standard input",
    type=click.Path(path_type=Path, exists=True, dir_okay=False, allow_dash=True),
)
entries = option(
    "--entries", "of that list where it is a tree; by default revocations.entries beside it", type=FILE
)
rules = option("--rules=FILE rules_path", "rules in XSLT instead of those that are shipped", type=FILE)
as_json = flag("--json as_json", "one line of JSON")
yes = flag("--yes", "do not ask")
reason = option("--reason", "why, for the record", default="")
domain = option("--domain", "trust domain of the authority", default="home", show_default=True)
HELP = "the result as one line of JSON"
AFTER: Final = 1.0  # seconds
_WIDTH: Final = 72  # one line, on every terminal
_CLEAR: Final = "\r\x1b[K"


def json_result(
    give: Callable[[Callable[..., Any]], Callable[..., Any]] | None = None, *, secret: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add `--json` to a command that records facts; `secret`: others must not read them.

    `give` passes it what it works with: the environment, the authority.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        inner = command if give is None else give(command)

        @flag("--json in_json", HELP)
        @functools.wraps(inner)
        def run(*given: Any, in_json: bool, **values: Any) -> Any:
            if not in_json:
                return inner(*given, **values)
            with document(secret=secret):
                return inner(*given, **values)

        return run

    return decorate


@contextmanager
def document(*, secret: bool = False) -> Iterator[None]:
    """Collect what is recorded, and print it at the end; after a refusal, if there is any."""
    # What was done before a refusal is done: the document says it, with the error (decision 0044).
    found: dict[str, Any] = {}
    token = FACTS.set(found)
    try:
        yield
    except HintedError as error:
        FACTS.reset(token)
        if found:
            _print({**found, "error": str(error), "hint": error.hint}, secret=secret)
        raise
    except BaseException:
        FACTS.reset(token)
        raise
    FACTS.reset(token)
    _print(found, secret=secret)


def _print(found: dict[str, Any], *, secret: bool) -> None:
    say_secret(to_json(found)) if secret else say_json(found)


def say_result(as_json: bool, document: object, lines: Iterable[str]) -> None:
    """Print a result: for programs as one line of JSON, for people its `lines`."""
    if as_json:
        say_json(document)
        return
    for line in lines:
        say(line)


class Batch:
    """The results of `total` names or files: one that is refused does not stop the others.

    With a single one its refusal is raised as it is. An unusable record ends the whole command.
    `key` is what they are called in the document: `file`, `name`, `id`.
    """

    def __init__(self, total: int, key: str = "file") -> None:
        self._total = total
        self._key = key
        self._entries: dict[str, dict[str, Any]] = {}
        self._failed = 0

    @property
    def done(self) -> bool:
        """Whether one or more of them were."""
        return self._failed < self._total

    @contextmanager
    def item(self, label: object, *, last: bool = True) -> Iterator[None]:
        """The work on one of them; `last`: it is done then, and not only checked."""
        if (name := str(label)) not in self._entries:
            self._entries[name] = {self._key: name, "ok": False}
            add_entry("results", self._entries[name])
        entry = self._entries[name]
        try:
            with recorded_in(entry):
                yield
        except HintedError as error:
            entry.update(error=str(error), hint=error.hint)
            # A record that cannot be used is no fault of a name: it would fail thirty times.
            if self._total == 1 or isinstance(error, RecordUnusable):
                raise
            self._failed += 1
            fail(f"{label}: {error}", error.hint)
        else:
            entry["ok"] = last

    def finish(self) -> None:
        if self._failed:
            raise ConfigurationError(f"{self._failed} of {self._total} were refused", "see above")


@contextmanager
def recorded_in(facts: dict[str, Any]) -> Iterator[None]:
    if FACTS.get() is None:
        yield
        return
    token = FACTS.set(facts)
    try:
        yield
    finally:
        FACTS.reset(token)


def add_entry(key: str, facts: dict[str, Any]) -> None:
    if (found := FACTS.get()) is not None:
        found.setdefault(key, []).append(facts)


def unique(names: Sequence[str]) -> tuple[str, ...]:
    """Each name once, in order: who names one twice means it once."""
    return tuple(dict.fromkeys(names))


@contextmanager
def working(what: str, *, quiet: bool = False) -> Iterator[None]:
    """Say `what` while the body runs, which asks for nothing; `quiet`: do not (`--json`).

    It is drawn anew each second, gives way to every other line, and leaves no trace: a pipe, a file
    and a program that reads `--json` never see it.
    """
    # Only on a terminal: a pipe or a log would keep each second of it.
    if quiet or not (FACTS.get() is None and not sys.stderr.closed and sys.stderr.isatty()):
        yield
        return
    line = _Line(what)
    try:
        yield
    finally:
        line.end()


class _Line:
    def __init__(self, what: str) -> None:
        self._what = printable(what)[:_WIDTH]
        self._begun = time.monotonic()
        self._done = threading.Event()
        self._drawing = threading.Lock()
        self._shown = False
        self._thread = threading.Thread(target=self._run, name="rossec busy", daemon=True)
        self._thread.start()
        TEMPORARY.append(self._take_away)

    def end(self) -> None:
        TEMPORARY.remove(self._take_away)
        self._done.set()
        self._thread.join()
        self._take_away()

    def _run(self) -> None:
        while not self._done.wait(AFTER):
            with self._drawing:
                self._write(f"{_CLEAR}{self._what} ({time.monotonic() - self._begun:.0f} s)")
                self._shown = True

    def _take_away(self) -> None:
        with self._drawing:
            if self._shown:
                self._write(_CLEAR)
            self._shown = False

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # the terminal is gone
            sys.stderr.write(text)
            sys.stderr.flush()
