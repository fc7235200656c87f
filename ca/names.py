"""Names: who a node is called, and the one place that knows the syntax.

A node name is an absolute ROS name (`/robot1/camera`). Its place of validity is the trust domain
(`home`). Both together form the SPIFFE ID `spiffe://home/robot1/camera`, the only name a
certificate carries. Both syntaxes are closed sets of ASCII, so there is exactly one spelling:
nothing is escaped, folded or normalised here, and two names are equal if their bytes are.
"""

import re
from typing import Final

from ca.errors import NameRefused

MAX_NAME: Final = 255
_NAME: Final = re.compile(r"(?:/[A-Za-z][A-Za-z0-9_]*)+")
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
        raise NameRefused(
            f"{text!a} is not an absolute ROS name",
            "write it as /robot1/camera: segments begin with a letter, then letters, digits or _",
        )
    return text


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
            "use lower case letters, digits, dots, dashes and underscores, for example home",
        )
    return text


def spiffe_id(domain: str, name: str) -> str:
    """Return `spiffe://<domain><name>`.

    Raises:
        NameRefused: `domain` or `name` is not one.
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
