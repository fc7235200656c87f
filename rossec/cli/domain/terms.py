"""The terms of a foreign domain as options and as lines of text."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

import click

from ca.domains.lists import LEAST_FRESH, MOST_FRESH, ForeignDomain, NameRights
from ca.names import MASTER, RELAY
from ca.patterns import check_pattern
from grants.model import ALL_RIGHTS, Right
from rossec.authority.home import fingerprint
from rossec.cli.shared.context import Duration
from rossec.clock import format_time
from rossec.errors import ConfigurationError

# Without these, the masters of two domains cannot follow each other, nor learn of revocations.
OF_MASTERS: Final = (MASTER, f"{MASTER}/*")
OF_RELAYS: Final = (RELAY, f"{RELAY}/*")  # without these no link between sites
EVERYTHING, NOTHING = "everything", "nothing"
MAX_DAYS: Final = 10 * 366
_RIGHTS: Final = {right.label: right for right in Right} | {"all": ALL_RIGHTS}
_RULE: Final = "'/robot/** subscribe', '/door/open call'; or everything, or nothing"
_UNITS: Final = ((86400, "d"), (3600, "h"), (60, "m"))

admit = click.option(
    "--admit", multiple=True, metavar="PATTERN",
    help="nodes of it that may connect; its masters and relays may as well",
)  # fmt: skip


def fresh(default: str | None) -> Callable[..., Any]:
    """Add `--fresh` to a command."""
    return click.option(
        "--fresh", type=Duration(MOST_FRESH // 86400), default=default, show_default=True,
        help="how old its last word on its revocations may be",
    )  # fmt: skip


def lifetime(default: str | None) -> Callable[..., Any]:
    """Add `--for` to a command."""
    return click.option(
        "--for", "lifetime", type=Duration(MAX_DAYS), default=default, show_default=True,
        help="how long it is trusted, from now on",
    )  # fmt: skip


def rules(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--export` and `--import` to a command."""
    for option, name, what in (
        ("--import", "imported", "taken from it into the graph here"),
        ("--export", "exported", "shown to it, where grants allow it too"),
    ):
        command = click.option(
            option, name, multiple=True, metavar="RULE", help=f"{what}: PATTERN RIGHT[,RIGHT]"
        )(command)
    return command


def check_fresh(seconds: int) -> int:
    """Return `seconds` if a domain's word may be so old.

    Raises:
        ConfigurationError: it is too short.
    """
    if seconds < LEAST_FRESH:
        raise ConfigurationError(
            f"--fresh {seconds}s is too short", f"masters ask every 10 s: at least {LEAST_FRESH}s"
        )
    return seconds


def admitted(patterns: Iterable[str]) -> tuple[str, ...]:
    """The patterns that are admitted: those given, masters and relays; each once, sorted."""
    return tuple(sorted({*map(check_pattern, patterns), *OF_MASTERS, *OF_RELAYS}))


def read_rules(texts: tuple[str, ...]) -> tuple[NameRights, ...] | None:
    """The rules of an export or import; None: no rule, and so no limit.

    Raises:
        ConfigurationError: not `PATTERN RIGHT[,RIGHT]`.
        PatternRefused: not a pattern.
    """
    if texts == (EVERYTHING,):
        return None
    return () if texts == (NOTHING,) else tuple(sorted(map(_rule, texts)))


def _rule(text: str) -> NameRights:
    pattern, _, listed = text.strip().partition(" ")
    bits = Right(0)
    for label in listed.replace(",", " ").split():
        if label not in _RIGHTS:
            raise ConfigurationError(f"{label!a} is not a right", f"one of {', '.join(_RIGHTS)}")
        bits |= _RIGHTS[label]
    if not bits:
        raise ConfigurationError(f"{text!a} is not a pattern and its rights", f"as in {_RULE}")
    return check_pattern(pattern), int(bits)


def lines(terms: ForeignDomain) -> Iterator[str]:
    """The terms for people."""
    yield f"  fingerprint {fingerprint(terms.anchor)}"
    yield f"  admits {_admitted(terms.admitted)}"
    yield f"  until {format_time(terms.until)}"
    yield f"  its word on its revocations may be {duration(terms.fresh)} old"
    for what, given in (("shown to it", terms.exported), ("taken from it", terms.imported)):
        if given is None:
            yield f"  {what}: whatever grants allow"
        else:
            said = (f"{pattern} ({Right(bits).label})" for pattern, bits in given)
            yield f"  {what}: {', '.join(said) or NOTHING}"


def _admitted(patterns: tuple[str, ...]) -> str:
    kinds = {"masters": OF_MASTERS, "relays": OF_RELAYS}
    nodes = [each for each in patterns if each not in {*OF_MASTERS, *OF_RELAYS}]
    whole = [word for word, names in kinds.items() if {*names} <= {*patterns}]
    return (", ".join(nodes) or "no node") + (f", and its {' and '.join(whole)}" if whole else "")


def as_json(terms: ForeignDomain) -> dict[str, Any]:
    """The terms for programs."""
    return {
        "label": terms.label,
        "domain": terms.domain,
        "fingerprint": terms.anchor.thumbprint.hex(),
        "admitted": [*terms.admitted],
        "fresh": terms.fresh,
        "until": terms.until,
        "exported": _rules_json(terms.exported),
        "imported": _rules_json(terms.imported),
    }


def duration(seconds: int) -> str:
    """Seconds as an option takes them: `1h`, `90s`."""
    for size, unit in _UNITS:
        if seconds % size == 0:
            return f"{seconds // size}{unit}"
    return f"{seconds}s"


def _rules_json(given: tuple[NameRights, ...] | None) -> list[dict[str, Any]] | None:
    if given is None:
        return None
    return [
        {"pattern": pattern, "rights": [right.label for right in Right(bits)]}
        for pattern, bits in given
    ]
