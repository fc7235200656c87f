"""Message definitions, and which side's definition a guard is built from. Pure.

ROS's md5 proves less than it seems: array brackets after the name of a message type are not part
of it (genmsg, `compute_md5_text`), so `Vector3[0] linear` has the md5 of `Vector3 linear`. A peer
that chooses the text could make a guard check other bytes than the receiver reads. So a guard is
built from the definition of the side that applies it: the receiver's own, or the one installed on
its host. A restricted publisher's definition is used only where the receiver's md5 proves it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

from ca.errors import HintedError
from grants.decision import Decision
from grants.errors import DefinitionIncomplete, DefinitionRefused
from grants.filters import layout
from grants.filters.layout import Layout
from grants.guard import check_type
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.header_fields import Fields, text
from rossec.participant.type_packages import what_to_install
from rossec.ros.names import ANY_TYPE

_RESTRICTED: Final = "the publisher's right is restricted, so this host must know the type"
_ROS_PATH: Final = "sidecars and gateways look for .msg files along ROS_PACKAGE_PATH"


@dataclass(frozen=True)
class Definition:
    """One message type: `name` is `package/Type`, `md5sum` and `definition` as in TCPROS."""

    name: str
    md5sum: str
    definition: str

    @property
    def octets(self) -> bytes:
        """The text as it is in a header: its comments need not be UTF-8."""
        return self.definition.encode(errors="surrogateescape")

    @cached_property
    def layout(self) -> Layout:
        """Where the fields of a message are in its bytes.

        Raises:
            DefinitionRefused: the text is not a definition.
            ConnectionHeaderRefused: its md5sum is another one.
        """
        shape = layout.parse(self.name, self.definition)
        if shape.md5 != self.md5sum:
            raise ConnectionHeaderRefused(
                f"the definition of {self.name} does not have the md5sum of the connection",
                "the grant is restricted, and the content of the messages cannot be checked",
            )
        return shape


def size_of(kind: Definition) -> int | None:
    """Size of every message of `kind` in bytes; None: it varies, or is not known."""
    try:
        return kind.layout.root.size
    except (DefinitionRefused, ConnectionHeaderRefused):
        return None


FindDefinition: TypeAlias = Callable[[str], Definition | None]
"""Finds the definition installed on this host by type name; None: not installed."""


def from_header(fields: Mapping[str, bytes]) -> Definition:
    """The type one side of a connection claims in its header; the definition may be missing.

    It is checked where it is needed: `Definition.layout` refuses text that is not UTF-8.

    Raises:
        ConnectionHeaderRefused: the type or md5sum is missing or is not text.
    """
    definition = fields.get("message_definition", b"").decode(errors="surrogateescape")
    return Definition(text(fields, "type"), text(fields, "md5sum"), definition)


def needs_definition(decision: Decision) -> bool:
    """Whether a restriction is for one message type; others apply to messages of any type."""
    return any(restriction.type is not None for restriction in decision.restrictions)


def receiver_definition(
    own: Definition, claimed: Definition, decision: Decision, find_installed: FindDefinition
) -> Definition:
    """The definition by which a receiver reads the messages of a publisher with this right.

    Args:
        own: the receiver's type: `*` for any, and roscpp sends no definition.
        claimed: the type the publisher claims.
        find_installed: called for types that the grant names, and no others.

    Raises:
        ConnectionHeaderRefused, GrantError: it is not known, or the right is for another type.
    """
    if own.definition or not needs_definition(decision):
        return sender_definition(own, decision, find_installed)
    name, md5sum = _either(own.name, claimed.name), _either(own.md5sum, claimed.md5sum)
    for restriction in decision.restrictions:
        check_type(name, restriction)
    candidate = Definition(name, md5sum, claimed.definition)
    if own.md5sum != ANY_TYPE and _is_proven(candidate):
        return candidate
    trusted = find_installed(name)
    if trusted is None or trusted.md5sum != md5sum:
        raise ConnectionHeaderRefused(
            f"how this subscriber reads a {name[:80]} is not known here",
            f"{_RESTRICTED}: {what_to_install(name[:80])}; {_ROS_PATH}",
        )
    return trusted


def sender_definition(
    own: Definition, decision: Decision, find_installed: FindDefinition
) -> Definition:
    """The definition of the messages a program sends, as it claims.

    It may repeat the claim of its own publisher, as `topic_tools relay` does: where the type is
    installed on this host, both definitions must be the same. Where it says less than its type
    has, nested types or all of it, the one that is installed here counts.

    Raises:
        ConnectionHeaderRefused, GrantError: they differ, or the text is not a definition or is of
        another type.
    """
    if not needs_definition(decision):
        return own
    for restriction in decision.restrictions:
        check_type(own.name, restriction)
    try:
        is_proven = own.layout.is_proven
    except (DefinitionIncomplete, ConnectionHeaderRefused) as error:
        return _instead_of(own, error, find_installed)
    if is_proven:
        return own
    trusted = find_installed(own.name)
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


def _instead_of(own: Definition, error: HintedError, find_installed: FindDefinition) -> Definition:
    """The installed definition for one that lacks nested types, or is empty.

    rosnodejs sends no nested types, other clients nothing at all. It is what the guard is built
    from and what receivers are told, so that both read the same.

    Raises:
        ConnectionHeaderRefused: none with the md5sum is installed; or there is a text, and it is
            of another type.
    """
    if isinstance(error, ConnectionHeaderRefused) and own.definition.strip():
        raise error
    trusted = find_installed(own.name)
    if trusted is not None and trusted.md5sum == own.md5sum:
        return trusted
    name = own.name[:80]
    raise ConnectionHeaderRefused(
        f"the program's definition of {name} does not say all of it: {error}",
        f"the right is restricted, so this host must know the type: {what_to_install(name)}",
    ) from error


def forwarded_definition(
    sent: Definition, decision: Decision, find_installed: FindDefinition
) -> Definition:
    """The definition of messages that are forwarded for somebody who is not trusted.

    As `sender_definition`, but where the md5sum does not prove it this host has to know the type:
    the restrictions of a subscriber may protect it from the sender.

    Raises:
        ConnectionHeaderRefused, GrantError: as there; or the type is not installed.
    """
    if needs_definition(decision) and not _is_proven(sent):
        trusted = find_installed(sent.name)
        if trusted is None or trusted.md5sum != sent.md5sum:
            raise ConnectionHeaderRefused(
                f"how a {sent.name[:80]} is read is not known on this host",
                "the subscriber's right is restricted, so this host must know the type:"
                f" {what_to_install(sent.name[:80])}",
            )
    return sender_definition(sent, decision, find_installed)


def definition_fields(kind: Definition, decision: Decision) -> Fields:
    """Header fields that replace the publisher's, where a guard depends on the definition.

    Programs that accept any type (rosbag, relays) use the definition in the header.
    """
    if not needs_definition(decision):
        return {}
    return {
        "type": kind.name.encode(),
        "md5sum": kind.md5sum.encode(),
        "message_definition": kind.octets,
    }


def reported_definition(own: Definition, claimed: Definition) -> Definition:
    """The receiver's type where no guard depends on it: its own, or a claim its md5sum proves."""
    candidate = Definition(own.name, own.md5sum, claimed.definition)
    return candidate if not own.definition and _is_proven(candidate) else own


def _is_proven(definition: Definition) -> bool:
    try:
        return definition.layout.is_proven
    except (DefinitionRefused, ConnectionHeaderRefused):
        return False


def _either(own: str, claimed: str) -> str:
    return claimed if own == ANY_TYPE else own
