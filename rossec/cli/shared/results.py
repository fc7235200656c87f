"""`--json` of commands that act: what they `record`, as one JSON document on stdout.

The document is printed when the command ends. If it ends with a refusal after something was done or
tried, the document has `error` and `hint` as well, so that a program sees what was done before.
Keys are documented in docs/spec/results.md.
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from ca.errors import HintedError
from rossec.terminal import FACTS, say_json, say_secret, to_json

HELP = "the result as one line of JSON"


def json_result(*, secret: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add `--json` to a command that records facts; `secret`: others must not read them."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @click.option("--json", "in_json", is_flag=True, help=HELP)
        @functools.wraps(command)
        def run(*given: Any, in_json: bool, **values: Any) -> Any:
            if not in_json:
                return command(*given, **values)
            with document(secret=secret):
                return command(*given, **values)

        return run

    return decorate


@contextmanager
def document(*, secret: bool = False) -> Iterator[None]:
    """Collect what is recorded, and print it at the end."""
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


@contextmanager
def recorded_in(facts: dict[str, Any]) -> Iterator[None]:
    """What is recorded meanwhile belongs to one entry of the document."""
    if FACTS.get() is None:
        yield
        return
    token = FACTS.set(facts)
    try:
        yield
    finally:
        FACTS.reset(token)


def add_entry(key: str, facts: dict[str, Any]) -> None:
    """Add an entry to the list `key` of the document, if there is one."""
    if (found := FACTS.get()) is not None:
        found.setdefault(key, []).append(facts)


def _print(found: dict[str, Any], *, secret: bool) -> None:
    say_secret(to_json(found)) if secret else say_json(found)
