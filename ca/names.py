"""Names: the syntax of node names, trust domains and SPIFFE IDs, patterns over them, and aliases.

A node name is an absolute ROS name (`/robot1/camera`), unique in its trust domain (`home`); relative
and private (`~`) names are refused. An identity with a wildcard tail also covers `/rviz_...`, the form of
anonymous nodes. `/remote/<label>/...` is the local alias of a name of another domain: it is on no
wire, in no grant of the origin, and cannot be enrolled. `/gateway/<label>/...` is what a gateway
serves of it, a name of the own domain (docs/decisions/0035).
"""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Final

from ca.errors import NameRefused, PatternRefused

MAX_NAME: Final = 255
_SIMILAR: Final = 0.6
_COMPARED: Final = 5000  # values; more would take a second
_SPELLED: Final = "ß=ss æ=ae Æ=AE ø=o Ø=O œ=oe Œ=OE ł=l Ł=L đ=d Đ=D"
_LETTERS: Final = str.maketrans(dict(each.split("=") for each in _SPELLED.split()))
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")
_NOT_IN_DOMAINS: Final = re.compile(r"[^a-z0-9._-]+")

AUTHORITY: Final = "/ca"  # the authority's own node
MASTER: Final = "/master"  # a domain's first master; others are `/master/<segment>`
RELAY: Final = "/relay"  # a domain's first relay; others are `/relay/<segment>`
GATEWAY: Final = "/gateway"  # a domain's first gateway; others are `/gateway/<segment>`
# ASCII, so there is exactly one spelling: nothing is escaped, folded or normalised.
_NAME: Final = re.compile(r"(?:/[A-Za-z][A-Za-z0-9_]*)+")
_SEGMENT: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_TAIL: Final = re.compile(r"_[A-Za-z0-9_]+")
_DOMAIN: Final = re.compile(r"[a-z0-9._-]+")  # SPIFFE-ID section 2.1
SCHEME: Final = "spiffe://"

# `rviz~` stands for `rviz` and all that a wildcard tail of `/rviz` covers, in the last segment of one
# node's name and nowhere else. Only grants to an identity with that tail have such patterns.
TAIL: Final = "~"
_WILDCARDS = ("*", "**")
_HINT: Final = "* stands for one whole segment, ** for one or more: /robot1/*/scan, /robot1/**"
_HINT_LABEL: Final = "a pattern is of one domain's own names, which have no label: /robot1/**"

REMOTE: Final = "/remote"
MAX_LABEL: Final = 32
_PREFIX: Final = f"{REMOTE}/"

_SERVED_PREFIX: Final = f"{GATEWAY}/"


def closest(value: str, known: Iterable[str]) -> str | None:
    """The known value most like `value`; None: none is like it."""
    values = sorted({str(each) for each in known})[:_COMPARED]
    import difflib  # noqa: PLC0415 - for mistakes alone

    found = difflib.get_close_matches(value, values, 1, _SIMILAR)
    return found[0] if found else None


def proposed_name(text: str) -> str | None:
    """The absolute ROS name most like `text`, which is none: `talker-1` -> `/talker_1`."""
    # None: there is nothing to keep, or it is private (`~pose`) and has its place elsewhere.
    if len(text) > MAX_NAME or text.startswith("~"):
        return None
    name = ""
    for each in _plain(text).split("/"):
        # What is not in a segment becomes `_`, and it begins with a letter.
        if kept := _NOT_IN_NAMES.sub("_", each).strip("_"):
            name += f"/n{kept}" if kept[0].isdigit() else f"/{kept}"
    return name if name and len(name) <= MAX_NAME else None


def proposed_domain(text: str) -> str | None:
    """The trust domain most like `text`, which is none: `My Home` -> `my-home`."""
    if len(text) > MAX_NAME:
        return None
    return _NOT_IN_DOMAINS.sub("-", _plain(text).lower()).strip("-") or None


def _plain(text: str) -> str:
    decomposed = unicodedata.normalize("NFKD", text.translate(_LETTERS))
    return "".join(each for each in decomposed if not unicodedata.combining(each))


def check_name(text: str) -> str:
    """Return `text` if it is an absolute ROS name of at most 255 characters."""
    if len(text) > MAX_NAME:
        raise NameRefused(
            f"a name of {len(text)} characters where at most {MAX_NAME} are allowed",
            "shorten the node's name or its namespace",
        )
    if _NAME.fullmatch(text) is None:
        proposed = proposed_name(text)
        example = "write it as /robot1/camera" if proposed is None else f"for example {proposed}"
        raise NameRefused(
            f"{text!a} is not an absolute ROS name",
            f"{example}: segments begin with a letter, then letters, digits or _",
        )
    return text


def check_domain(text: str) -> str:
    """Return `text` if it is a trust domain: lower case letters, digits and `.-_`."""
    if len(text) > MAX_NAME:
        raise NameRefused(
            f"a trust domain of {len(text)} characters where at most {MAX_NAME} are allowed",
            "choose a short name for the site, for example home",
        )
    if _DOMAIN.fullmatch(text) is None:
        raise NameRefused(
            f"{text!a} is not a trust domain",
            "use lower case letters, digits, dots, dashes and underscores, for example"
            f" {proposed_domain(text) or 'home'}",
        )
    return text


def covers(name: str, asked: str, *, wildcard: bool) -> bool:
    """Whether an identity for `name`, with or without a wildcard tail, may use the name `asked`."""
    # A tail is `_` and at least one more character of the same segment: `/rviz` covers `/rviz_1_2`, never
    # `/rviz_`, `/rvizx`, `/rviz_a/b` or `/robot1/rviz_1`.
    if asked == name:
        return True
    if not wildcard or len(asked) > MAX_NAME or is_reserved(asked) or not asked.startswith(name):
        return False
    return _TAIL.fullmatch(asked, len(name)) is not None


def is_master_name(name: str) -> bool:
    """Whether a master is certified for `name`: `/master`, or `/master` and one segment."""
    return _is_at(MASTER, name)


def is_relay_name(name: str) -> bool:
    return _is_at(RELAY, name)


def is_gateway(name: str) -> bool:
    return _is_at(GATEWAY, name)


def _is_at(place: str, name: str) -> bool:
    rest = name.removeprefix(f"{place}/")
    return name == place or (rest != name and _SEGMENT.fullmatch(rest) is not None)


def is_reserved(name: str) -> bool:
    """Whether nodes trust the holder of `name`, so that no wildcard covers it."""
    return name == AUTHORITY or is_master_name(name) or is_relay_name(name) or is_gateway(name)


def check_wildcard(name: str) -> str:
    """Return `name` if an identity for it may have a wildcard tail."""
    if is_reserved(name):
        raise NameRefused(
            f"{name} is a single node and cannot have a wildcard tail",
            "anonymous nodes need a name of their own",
        )
    return name


def spiffe_id(domain: str, name: str) -> str:
    return f"{SCHEME}{check_domain(domain)}{check_name(name)}"


def parse_spiffe_id(text: str) -> tuple[str, str]:
    if not text.startswith(SCHEME):
        raise NameRefused(f"{text[:MAX_NAME]!a} is not a SPIFFE ID")
    domain, slash, path = text.removeprefix(SCHEME).partition("/")
    return check_domain(domain), check_name(slash + path)


def check_pattern(text: str) -> str:
    """Return `text` if it is a name in which whole segments may be `*` or `**`."""
    segments = ["x" if segment in _WILDCARDS else segment for segment in text.split("/")]
    try:
        check_name("/".join(segments))
    except NameRefused as error:
        proposed = None if "*" in text else proposed_name(text)
        hint = _HINT if proposed is None else f"for example {proposed}; {_HINT}"
        hint = _HINT_LABEL if ":/" in text else hint
        raise PatternRefused(f"not a name pattern: {error}", hint) from None
    return text


def check_tail_pattern(text: str) -> str:
    base, mark, rest = text.partition(TAIL)
    if not mark:
        return check_pattern(text)
    try:
        check_wildcard(check_name(base))
    except NameRefused as error:
        raise PatternRefused(f"not a tail pattern: {error}", error.hint) from None
    if rest and not rest.startswith("/"):
        raise PatternRefused(f"not a tail pattern: {text[:80]!a}", "for example /rviz~/get_loggers")
    check_pattern(base + rest)
    return text


def tail_base(pattern: str) -> str | None:
    """The node whose tail a tail pattern is about; None for any other pattern."""
    base, mark, _ = pattern.partition(TAIL)
    return base if mark else None


def fits(segment: str, found: str) -> bool:
    """Whether one segment of a pattern, other than `**`, stands for the segment `found`."""
    # `found` may be one of a tail pattern: then whether it stands for all of its names.
    if segment in ("*", found):
        return True
    if not segment.endswith(TAIL):
        return False
    base, found = segment[:-1], found.removesuffix(TAIL)
    return found == base or (found.startswith(f"{base}_") and len(found) > len(base) + 1)


def pattern_covers(pattern: str, name: str) -> bool:
    """Whether `pattern` covers `name`, segment by segment; it may be a tail pattern."""
    check_tail_pattern(pattern)
    check_name(name)
    if "*" not in pattern and TAIL not in pattern:
        return pattern == name
    # Whole segments are compared, so `/a` never covers `/ab` (the prefix confusion of ROSRV).
    segments = _segments(name)
    return len(segments) in _match_ends(_segments(pattern), segments)


def covers_tree(pattern: str, name: str) -> bool:
    """Whether `pattern` covers `name` or a parent of it."""
    # For parameters: setting `/a` also sets every `/a/...`, because the value may be a tree. So a right to a
    # key is always a right to all of its descendants, and never to a parent.
    pattern_segments = _pattern_segments(pattern)
    check_name(name)
    return bool(_match_ends(pattern_segments, _segments(name)))


def covers_below(pattern: str, namespace: str) -> bool:
    below = [*_namespace_segments(namespace), _WILDCARDS[0]]  # a segment that only wildcards match
    return bool(_match_ends(_pattern_segments(pattern), below))


def touches(pattern: str, namespace: str) -> bool:
    name, ends = _namespace_segments(namespace), {0}
    for segment in _pattern_segments(pattern):
        if len(name) in ends:  # the rest of the pattern covers names below
            return True
        ends = _advance(ends, segment, name)
    return bool(ends)


def _namespace_segments(text: str) -> list[str]:
    return [] if text == "/" else text[1:].split("/")


def _segments(text: str) -> list[str]:
    return text[1:].split("/")


@lru_cache(maxsize=4096)
def _pattern_segments(pattern: str) -> tuple[str, ...]:
    return (*_segments(check_tail_pattern(pattern)),)


def _match_ends(pattern: Sequence[str], name: list[str]) -> set[int]:
    # A set of positions instead of backtracking: time is the product of the lengths for every pattern (a
    # chain of `**` would be exponential in a regular expression).
    ends = {0}
    for segment in pattern:
        if not ends:
            break
        ends = _advance(ends, segment, name)
    return ends


def _advance(ends: set[int], segment: str, name: list[str]) -> set[int]:
    if segment == "**":
        return set(range(min(ends, default=len(name)) + 1, len(name) + 1))
    if TAIL in segment:
        return {at + 1 for at in ends if at < len(name) and fits(segment, name[at])}
    # As `fits`, without a call for each segment: the master checks thousands of names in one turn.
    return {at + 1 for at in ends if at < len(name) and segment in ("*", name[at])}


def check_label(text: str) -> str:
    """Return `text` if it is a label: one segment of a name, at most 32 characters."""
    if len(text) > MAX_LABEL or _SEGMENT.fullmatch(text) is None:
        raise NameRefused(
            f"{text[:MAX_NAME]!a} is not a label",
            f"one word of at most {MAX_LABEL} letters, digits or _, for example hospital",
        )
    return text


def alias_of(label: str, name: str) -> str:
    """The local name of `name`, an absolute name of the origin `label`."""
    # Else two masters that follow each other would pass a name round and round, longer each time.
    if is_alias(check_name(name)):
        raise NameRefused(f"{name} is an alias at the origin itself", "a name travels one hop")
    return check_name(f"{_PREFIX}{check_label(label)}{name}")


def split_alias(name: str) -> tuple[str, str] | None:
    """The label and the origin's name of an alias; None: a name of the own domain."""
    if not is_alias(name):
        return None
    label, slash, rest = name.removeprefix(_PREFIX).partition("/")
    if name == REMOTE or not slash:
        raise NameRefused(f"{name} names no origin", "/remote/LABEL/NAME")
    return check_label(label), check_name(slash + rest)


def origin_of(name: str) -> str:
    """The name on the wire: that of the origin for an alias, else `name` itself."""
    found = split_alias(name)
    return name if found is None else found[1]


def is_alias(name: str) -> bool:
    return name == REMOTE or name.startswith(_PREFIX)


def refuse_alias(name: str) -> str:
    """Return `name` if it is not below `/remote`: for what can have no alias."""
    if is_alias(name):
        raise NameRefused(
            f"{name[:MAX_NAME]!a} is below {REMOTE}, which stands for other masters' names",
            "choose another name",
        )
    return name


def display_name(domain_label: str, name: str) -> str:
    return f"{domain_label}:{name}" if domain_label else name


def shown(name: str) -> str:
    """A local name for people: an alias as `hospital:/robot/pose`, any other text as it is."""
    try:
        found = split_alias(name)
    except NameRefused:
        return name
    return name if found is None else display_name(*found)


def local_name(text: str) -> str:
    """The local name of what a person wrote: `hospital:/robot/pose` is an alias."""
    # Text without a colon is returned as it is: it may be a relative name.
    label, colon, name = text.partition(":")
    return alias_of(label, name) if colon else text


def local_pattern(text: str) -> str:
    label, colon, pattern = text.partition(":")
    if not colon:
        return check_pattern(text)
    if is_alias(check_pattern(pattern)):
        raise NameRefused(f"{pattern} is an alias at the origin itself", "a name travels one hop")
    return check_pattern(f"{_PREFIX}{check_label(label)}{pattern}")


def served_name(alias: str) -> str:
    """The served name of an alias: `/gateway/hospital/pose` for `/remote/hospital/pose`."""
    # A name of the own domain: its authority grants rights on it, and never on the alias.
    found = split_alias(alias)
    if found is None:
        raise NameRefused(f"{alias} is a name of this domain: no gateway serves it")
    alias_of(*found)  # an alias at the origin itself is served by nobody: one hop
    return check_name(f"{_SERVED_PREFIX}{found[0]}{found[1]}")


def alias_of_served(name: str) -> str | None:
    """The alias that a served name stands for; None: it is no served name."""
    if not is_in_gateway(name):
        return None
    label, slash, rest = name.removeprefix(_SERVED_PREFIX).partition("/")
    try:
        check_name(name)
        return alias_of(label, slash + rest)
    except NameRefused:
        return None


def is_served(name: str) -> bool:
    return alias_of_served(name) is not None


def is_in_gateway(name: str) -> bool:
    """Whether a name lies below `/gateway`: nobody but gateways publishes there."""
    return name.startswith(_SERVED_PREFIX)
