"""What a message type is said to be, and whose word a guard is built from. Pure.

ROS's md5 proves less than it seems: behind the name of a message type array brackets are not part
of it (genmsg, `compute_md5_text`), so `Vector3[0] linear` has the md5 of `Vector3 linear`. Whoever
may choose the text could move a guard's eyes to other bytes than the receiver reads. So a guard is
built from the definition of the side that applies it: a receiver's own, or what its host knows of
the type. What a restricted publisher says is taken only where the receiver's md5 proves it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

from grants.decision import Decision
from grants.errors import DefinitionRefused
from grants.filters import layout
from grants.filters.layout import Layout
from grants.guard import check_type
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.header_fields import Fields, text
from rossec.ros.names import ANY_TYPE

_HINT: Final = (
    "the publisher's right is restricted: install the package of this message type on this host;"
    " a sidecar looks for its .msg files along ROS_PACKAGE_PATH"
)


@dataclass(frozen=True)
class Definition:
    """One message type: `name` is `package/Type`, `md5sum` and `definition` as in TCPROS."""

    name: str
    md5sum: str
    definition: str

    @cached_property
    def layout(self) -> Layout:
        """Where the fields of a message are in its bytes.

        Raises:
            DefinitionRefused: the text is no definition.
            ConnectionHeaderRefused: it is not the one of the md5sum.
        """
        shape = layout.parse(self.name, self.definition)
        if shape.md5 != self.md5sum:
            raise ConnectionHeaderRefused(
                f"the definition of {self.name} does not have the md5sum of the connection",
                "the grant is restricted, and what is sent cannot be told",
            )
        return shape


def size_of(kind: Definition) -> int | None:
    """Bytes of every message of `kind`; None: they differ, or nothing is known of them."""
    try:
        return kind.layout.root.size
    except (DefinitionRefused, ConnectionHeaderRefused):
        return None


FindDefinition: TypeAlias = Callable[[str], Definition | None]
"""What this host itself knows of the type with that name; None: nothing."""


def from_header(fields: Mapping[str, bytes]) -> Definition:
    """What one side of a connection says in its header; the definition may be left out.

    It is judged where it is needed: `Definition.layout` refuses what is not UTF-8.

    Raises:
        ConnectionHeaderRefused: no type or md5sum, or not text.
    """
    definition = fields.get("message_definition", b"").decode(errors="surrogateescape")
    return Definition(text(fields, "type"), text(fields, "md5sum"), definition)


def needs_definition(decision: Decision) -> bool:
    """Whether a restriction is for messages of one type; others need not know what they are."""
    return any(restriction.type is not None for restriction in decision.restrictions)


def receiver_definition(
    own: Definition, said: Definition, decision: Decision, known: FindDefinition
) -> Definition:
    """By what a receiver reads the messages of a publisher with this right.

    Args:
        own: what the receiver says of itself: `*` for any type, and roscpp sends no definition.
        said: what the publisher says.
        known: is asked about types which the grant names, and no others.

    Raises:
        ConnectionHeaderRefused, GrantError: that cannot be known, or the right is for another type.
    """
    if own.definition or not needs_definition(decision):
        return sender_definition(own, decision, known)
    name, md5sum = _either(own.name, said.name), _either(own.md5sum, said.md5sum)
    for restriction in decision.restrictions:
        check_type(name, restriction)
    claimed = Definition(name, md5sum, said.definition)
    if own.md5sum != ANY_TYPE and _is_proven(claimed):
        return claimed
    trusted = known(name)
    if trusted is None or trusted.md5sum != md5sum:
        raise ConnectionHeaderRefused(
            f"how this subscriber reads a {name[:80]} is not known here", _HINT
        )
    return trusted


def sender_definition(own: Definition, decision: Decision, known: FindDefinition) -> Definition:
    """By what a program sends, as it says itself.

    It may repeat what its own publisher said, as `topic_tools relay` does: where this host knows
    the type, both must mean the same.

    Raises:
        ConnectionHeaderRefused, GrantError: they do not, the text is no definition, or of another
        type.
    """
    if not needs_definition(decision):
        return own
    for restriction in decision.restrictions:
        check_type(own.name, restriction)
    if own.layout.is_proven:
        return own
    trusted = known(own.name)
    if (
        trusted is None
        or trusted.md5sum != own.md5sum
        or trusted.layout.digest == own.layout.digest
    ):
        return own
    raise ConnectionHeaderRefused(
        f"the program's definition of {own.name} is not the one this host knows",
        "it has the same md5sum but other arrays: update the package on one side",
    )


def definition_fields(kind: Definition, decision: Decision) -> Fields:
    """What a subscriber is told in the publisher's place, where a guard reads its messages.

    Programs that take any type (rosbag, relays) read by the definition in the header.
    """
    if not needs_definition(decision):
        return {}
    return {
        "type": kind.name.encode(),
        "md5sum": kind.md5sum.encode(),
        "message_definition": kind.definition.encode(),
    }


def reported_definition(own: Definition, said: Definition) -> Definition:
    """What a receiver reads, where no guard depends on it: what it says, or its md5sum proves."""
    claimed = Definition(own.name, own.md5sum, said.definition)
    return claimed if not own.definition and _is_proven(claimed) else own


def _is_proven(claimed: Definition) -> bool:
    try:
        return claimed.layout.is_proven
    except (DefinitionRefused, ConnectionHeaderRefused):
        return False


def _either(own: str, said: str) -> str:
    return said if own == ANY_TYPE else own
