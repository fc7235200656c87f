"""Names: the syntax of node names, trust domains and SPIFFE IDs.

A node name is an absolute ROS name (`/robot1/camera`). It is unique in its trust domain (`home`).
Together they form the SPIFFE ID `spiffe://home/robot1/camera`, the only name in a certificate.
Both syntaxes are subsets of ASCII, so there is exactly one spelling: nothing is escaped, folded
or normalised, and two names are equal if their bytes are.

An identity with a wildcard tail covers its name, and that name followed by `_` and more:
`/rviz` also covers `/rviz_1234_1700000000000`, the form of the names of anonymous nodes in ROS.
"""

import re
from typing import Final

from ca.errors import NameRefused
from ca.suggestions import proposed_domain, proposed_name

MAX_NAME: Final = 255
AUTHORITY: Final = "/ca"  # the authority's own node
MASTER: Final = "/master"  # a domain's first master; others are `/master/<segment>`
RELAY: Final = "/relay"  # a domain's first relay; others are `/relay/<segment>`
GATEWAY: Final = "/gateway"  # a domain's first gateway; others are `/gateway/<segment>`
_NAME: Final = re.compile(r"(?:/[A-Za-z][A-Za-z0-9_]*)+")
_OTHER_MASTER: Final = re.compile(r"/master/[A-Za-z][A-Za-z0-9_]*")
_OTHER_RELAY: Final = re.compile(r"/relay/[A-Za-z][A-Za-z0-9_]*")
_OTHER_GATEWAY: Final = re.compile(r"/gateway/[A-Za-z][A-Za-z0-9_]*")
_TAIL: Final = re.compile(r"_[A-Za-z0-9_]+")
_DOMAIN: Final = re.compile(r"[a-z0-9._-]+")  # SPIFFE-ID section 2.1
_SCHEME: Final = "spiffe://"


def check_name(text: str) -> str:
    """Return `text` if it is an absolute ROS name of at most 255 characters.

    Raises:
        NameRefused: anything else; relative and private (`~`) names must be resolved before.
    """
    if len(text) > MAX_NAME:
        raise NameRefused(
            f"a name of {len(text)} characters where at most {MAX_NAME} are allowed",
            "shorten the node's name or its namespace",
        )
    if _NAME.fullmatch(text) is None:
        raise NameRefused(f"{text!a} is not an absolute ROS name", _name_hint(text))
    return text


def _name_hint(text: str) -> str:
    proposed = proposed_name(text)
    example = "write it as /robot1/camera" if proposed is None else f"for example {proposed}"
    return f"{example}: segments begin with a letter, then letters, digits or _"


def check_domain(text: str) -> str:
    """Return `text` if it is a trust domain: lower case letters, digits and `.-_`.

    Raises:
        NameRefused: anything else (SPIFFE-ID section 2.1).
    """
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
    """Whether an identity for `name`, with or without a wildcard tail, may use the name `asked`.

    A tail is `_` and at least one more character of the same segment: `/rviz` covers `/rviz_1_2`,
    never `/rviz_`, `/rvizx`, `/rviz_a/b` or `/robot1/rviz_1`.
    """
    if asked == name:
        return True
    if not wildcard or len(asked) > MAX_NAME or is_reserved(asked) or not asked.startswith(name):
        return False
    return _TAIL.fullmatch(asked, len(name)) is not None


def is_master_name(name: str) -> bool:
    """Whether a master is certified for `name`: `/master`, or `/master` and one segment."""
    return name == MASTER or _OTHER_MASTER.fullmatch(name) is not None


def is_relay_name(name: str) -> bool:
    """Whether a relay is certified for `name`: `/relay`, or `/relay` and one segment."""
    return name == RELAY or _OTHER_RELAY.fullmatch(name) is not None


def is_gateway(name: str) -> bool:
    """Whether a gateway is certified for `name`: `/gateway`, or `/gateway` and one segment."""
    return name == GATEWAY or _OTHER_GATEWAY.fullmatch(name) is not None


def is_reserved(name: str) -> bool:
    """Whether nodes trust the holder of `name`, so that no wildcard covers it."""
    return name == AUTHORITY or is_master_name(name) or is_relay_name(name) or is_gateway(name)


def check_wildcard(name: str) -> str:
    """Return `name` if an identity for it may have a wildcard tail.

    Raises:
        NameRefused: it is the name of a master, relay or gateway, or of the authority.
    """
    if is_reserved(name):
        raise NameRefused(
            f"{name} is a single node and cannot have a wildcard tail",
            "anonymous nodes need a name of their own",
        )
    return name


def spiffe_id(domain: str, name: str) -> str:
    """Return `spiffe://<domain><name>`.

    Raises:
        NameRefused: `domain` or `name` is invalid.
    """
    return f"{_SCHEME}{check_domain(domain)}{check_name(name)}"


def parse_spiffe_id(text: str) -> tuple[str, str]:
    """Split a SPIFFE ID into trust domain and name: the exact inverse of `spiffe_id`.

    Raises:
        NameRefused: not what `spiffe_id` writes; SPIFFE's wider path syntax is refused too.
    """
    if not text.startswith(_SCHEME):
        raise NameRefused(f"{text[:MAX_NAME]!a} is not a SPIFFE ID")
    domain, slash, path = text.removeprefix(_SCHEME).partition("/")
    return check_domain(domain), check_name(slash + path)
