"""Names of other masters and domains here: `/remote/<label>`, then the name at the origin.

The only place that maps between the two. A label is chosen by the importing side; an alias is a
local name: it is on no wire, in no grant of the origin, and cannot be registered or enrolled. What
is not below `/remote` is a name of the own domain.
"""

import re
from typing import Final

from ca.errors import NameRefused
from ca.names import MAX_NAME, check_name
from ca.patterns import check_pattern

REMOTE: Final = "/remote"
MAX_LABEL: Final = 32
_LABEL: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_PREFIX: Final = f"{REMOTE}/"


def check_label(text: str) -> str:
    """Return `text` if it is a label: one segment of a name, at most 32 characters.

    Raises:
        NameRefused: anything else.
    """
    if len(text) > MAX_LABEL or _LABEL.fullmatch(text) is None:
        raise NameRefused(
            f"{text[:MAX_NAME]!a} is not a label",
            f"one word of at most {MAX_LABEL} letters, digits or _, for example hospital",
        )
    return text


def alias_of(label: str, name: str) -> str:
    """The local name of `name`, an absolute name of the origin `label`.

    Raises:
        NameRefused: a label or name that is not one, an alias, or an alias longer than a name.
    """
    if is_alias(check_name(name)):
        raise NameRefused(f"{name} is an alias at the origin itself", "a name travels one hop")
    return check_name(f"{_PREFIX}{check_label(label)}{name}")


def split_alias(name: str) -> tuple[str, str] | None:
    """The label and the origin's name of an alias; None: a name of the own domain.

    Raises:
        NameRefused: below `/remote`, but no label and name follow.
    """
    if not is_alias(name):
        return None
    label, slash, rest = name.removeprefix(_PREFIX).partition("/")
    if name == REMOTE or not slash:
        raise NameRefused(f"{name} names no origin", "/remote/LABEL/NAME")
    return check_label(label), check_name(slash + rest)


def origin_of(name: str) -> str:
    """The name on the wire: that of the origin for an alias, else `name` itself.

    Raises:
        NameRefused: as `split_alias`.
    """
    found = split_alias(name)
    return name if found is None else found[1]


def is_alias(name: str) -> bool:
    """Whether a name lies in `/remote`."""
    return name == REMOTE or name.startswith(_PREFIX)


def refuse_alias(name: str) -> str:
    """Return `name` if it is not below `/remote`: for what can have no alias.

    Raises:
        NameRefused: it is.
    """
    if is_alias(name):
        raise NameRefused(
            f"{name[:MAX_NAME]!a} is below {REMOTE}, which stands for other masters' names",
            "choose another name",
        )
    return name


def display_name(domain_label: str, name: str) -> str:
    """For people: `hospital:/robot/pose`; a name of the own domain (label empty) as it is."""
    return f"{domain_label}:{name}" if domain_label else name


def shown(name: str) -> str:
    """A local name for people: an alias as `hospital:/robot/pose`, any other text as it is."""
    try:
        found = split_alias(name)
    except NameRefused:
        return name
    return name if found is None else display_name(*found)


def local_name(text: str) -> str:
    """The local name of what a person wrote: `hospital:/robot/pose` is an alias.

    Text without a colon is returned as it is: it may be a relative name.

    Raises:
        NameRefused: what is around the colon is no label and absolute name.
    """
    label, colon, name = text.partition(":")
    return alias_of(label, name) if colon else text


def local_pattern(text: str) -> str:
    """The pattern of local names of what a person wrote: `hospital:/rounds/*` is one of aliases.

    Raises:
        NameRefused: what is around the colon is no label and pattern, or it is no pattern.
    """
    label, colon, pattern = text.partition(":")
    if not colon:
        return check_pattern(text)
    if is_alias(check_pattern(pattern)):
        raise NameRefused(f"{pattern} is an alias at the origin itself", "a name travels one hop")
    return check_pattern(f"{_PREFIX}{check_label(label)}{pattern}")
