"""What a gateway serves of another domain: `/gateway/<label>`, then the name at the origin.

A served name stands for the same thing as the alias `/remote/<label>/...`, but it is a name of the
own domain: its authority grants rights on it, and never on the alias, where the origin's count. The
only place that maps between the two (docs/decisions/0035). A label is never the last segment, so
no served name is the name of a gateway.
"""

from typing import Final

from ca.domains.aliases import alias_of, split_alias
from ca.errors import NameRefused
from ca.names import GATEWAY, check_name, is_gateway

__all__ = (
    "GATEWAY",
    "alias_of_served",
    "is_gateway",
    "is_in_gateway",
    "is_served",
    "served_name",
)

_PREFIX: Final = f"{GATEWAY}/"


def served_name(alias: str) -> str:
    """The served name of an alias: `/gateway/hospital/pose` for `/remote/hospital/pose`.

    Raises:
        NameRefused: no alias of a label and a name, or a served name that would be too long.
    """
    found = split_alias(alias)
    if found is None:
        raise NameRefused(f"{alias} is a name of this domain: no gateway serves it")
    alias_of(*found)  # an alias at the origin itself is served by nobody: one hop
    return check_name(f"{_PREFIX}{found[0]}{found[1]}")


def alias_of_served(name: str) -> str | None:
    """The alias that a served name stands for; None: it is no served name."""
    if not is_in_gateway(name):
        return None
    label, slash, rest = name.removeprefix(_PREFIX).partition("/")
    try:
        check_name(name)
        return alias_of(label, slash + rest)
    except NameRefused:
        return None


def is_served(name: str) -> bool:
    """Whether a gateway may serve something under `name`: a label and a name are in it."""
    return alias_of_served(name) is not None


def is_in_gateway(name: str) -> bool:
    """Whether a name lies below `/gateway`: nobody but gateways publishes there."""
    return name.startswith(_PREFIX)
