"""Message definitions, which side's definition a guard is built from, and the guard of a connection. Pure.

ROS's md5 proves less than it seems: array brackets after the name of a message type are not part of it
(genmsg, `compute_md5_text`), so `Vector3[0] linear` has the md5 of `Vector3 linear`. A peer that chooses the
text could make a guard check other bytes than the receiver reads. So a guard is built from the definition of
the side that applies it: the receiver's own, or the one installed on its host. A restricted publisher's
definition is used only where the receiver's md5 proves it.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

from ca.names import closest
from grants.decision import Decision
from grants.errors import DefinitionIncomplete, DefinitionRefused
from grants.filters import layout
from grants.filters.layout import Layout
from grants.guard import Guard, MemoryScope, check_type, needed_keys
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.handshakes import Fields, text
from rossec.ros.names import ANY_TYPE

_IN_ROS: Final = frozenset(
    {
        "actionlib_msgs",
        "diagnostic_msgs",
        "geometry_msgs",
        "map_msgs",
        "move_base_msgs",
        "nav_msgs",
        "pcl_msgs",
        "rosgraph_msgs",
        "sensor_msgs",
        "shape_msgs",
        "std_msgs",
        "std_srvs",
        "stereo_msgs",
        "tf2_msgs",
        "trajectory_msgs",
        "visualization_msgs",
    }
)
"""Of these Debian has the definitions in `ros-...`."""
_OTHERS: Final = {
    "actionlib": "libactionlib-dev",
    "bond": "libbond-dev",
    "nodelet": "libnodelet-dev",
    "roscpp": "ros-roscpp-msg",
    "topic_tools": "ros-topic-tools-srvs",
}
_RESTRICTED: Final = "the publisher's right is restricted, so this host must know the type"
_ROS_PATH: Final = "sidecars and gateways look for .msg files along ROS_PACKAGE_PATH"


def what_to_install(type_name: str) -> str:
    package = type_name.partition("/")[0]
    ours = f"of ROS for Ubuntu: ros-noetic-{_dashed(package)}"
    if (theirs := _debian(package)) is not None:
        return f"it is in Debian's package {theirs} ({ours}): apt install {theirs}"
    return (
        f"Debian does not have it ({ours}); of a workspace: name the folder of {package} in ROS_PACKAGE_PATH"
    )


def unknown_type(type_name: str, known: Iterable[str]) -> str:
    """The hint where a message type is not known: one of that package, or what to install."""
    package, _, leaf = type_name.partition("/")
    pairs = (name.partition("/") for name in known)
    same = [each for its, _, each in pairs if its == package]
    if same:
        near = closest(leaf, same)
        meant = f"did you mean {package}/{near}? " if near is not None else ""
        own = f"one of your own: register_type(), or the folder of its {package} in ROS_PACKAGE_PATH"
        return f"{meant}it is none of {package} as it is known here; {own}"
    near = None if _debian(package) is not None else closest(type_name, known)
    if near is not None:
        return f"did you mean {near}? else {what_to_install(type_name)}"
    return what_to_install(type_name)


def _debian(package: str) -> str | None:
    return f"ros-{_dashed(package)}" if package in _IN_ROS else _OTHERS.get(package)


def _dashed(package: str) -> str:
    return package.replace("_", "-").lower()


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


FilterKey = Callable[[str], bytes]
FindDefinition: TypeAlias = Callable[[str], Definition | None]
"""Finds the definition installed on this host by type name; None: not installed."""


def from_header(fields: Mapping[str, bytes]) -> Definition:
    """The type one side of a connection claims in its header; the definition may be missing. It is checked
    where it is needed: `Definition.layout` refuses text that is not UTF-8."""
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


def sender_definition(own: Definition, decision: Decision, find_installed: FindDefinition) -> Definition:
    """The definition of the messages a program sends, as it claims.

    It may repeat the claim of its own publisher, as `topic_tools relay` does: where the type is
    installed on this host, both definitions must be the same. Where it says less than its type
    has, nested types or all of it, the one that is installed here counts.
    """
    if not needs_definition(decision):
        return own
    for restriction in decision.restrictions:
        check_type(own.name, restriction)
    try:
        is_proven = own.layout.is_proven
    except (DefinitionIncomplete, ConnectionHeaderRefused) as error:
        # rosnodejs sends no nested types, other clients nothing at all: what is installed is what the guard
        # is built from and what receivers are told, so that both read the same.
        if isinstance(error, ConnectionHeaderRefused) and own.definition.strip():
            raise
        trusted = find_installed(own.name)
        if trusted is not None and trusted.md5sum == own.md5sum:
            return trusted
        name = own.name[:80]
        raise ConnectionHeaderRefused(
            f"the program's definition of {name} does not say all of it: {error}",
            f"the right is restricted, so this host must know the type: {what_to_install(name)}",
        ) from error
    if is_proven:
        return own
    trusted = find_installed(own.name)
    if trusted is None or trusted.md5sum != own.md5sum or trusted.layout.digest == own.layout.digest:
        return own
    raise ConnectionHeaderRefused(
        f"the program's definition of {own.name} is not the one this host knows",
        "it has the same md5sum but other arrays: update the package on one side",
    )


def forwarded_definition(sent: Definition, decision: Decision, find_installed: FindDefinition) -> Definition:
    """The definition of messages that are forwarded for somebody who is not trusted.

    As `sender_definition`, but where the md5sum does not prove it this host has to know the type:
    the restrictions of a subscriber may protect it from the sender.
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
    """Header fields that replace the publisher's, where a guard depends on the definition. Programs that
    accept any type (rosbag, relays) use the definition in the header."""
    if not needs_definition(decision):
        return {}
    return {"type": kind.name.encode(), "md5sum": kind.md5sum.encode(), "message_definition": kind.octets}


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


def guard_for(
    kind: Definition, decision: Decision, filter_key: FilterKey, memory: MemoryScope
) -> Guard | None:
    """The guard that applies restrictions to the messages of one connection; None: nothing to apply.

    Each side applies those of the other: a publisher the subscriber's, before a message is sent; a subscriber
    the publisher's, before a message is accepted. `memory` finds what earlier connections of the same key
    have used up. Without a guard, the watchdog still closes the connection when the right expires.
    """
    if not decision.restrictions:
        return None
    keys = {key: filter_key(key) for key in needed_keys(decision.restrictions)}
    shape = kind.layout if needs_definition(decision) else None
    return Guard(shape, decision, keys, memory)
