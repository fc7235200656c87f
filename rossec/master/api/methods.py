"""The types of a master method: its arguments, default and handler, and what handlers return."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from grants.model import Right
from rossec.master.api.arguments import Check
from rossec.master.rights.caller import Caller
from rossec.master.state.import_events import TypeContradicted
from rossec.master.state.parameter_journal import ParameterChange
from rossec.master.state.registry import Event, NodeRef


@dataclass(frozen=True)
class ParameterChanged:
    """Notify one subscriber that a parameter has this value now ({}: unset)."""

    node: NodeRef
    key: str
    value: object


@dataclass(frozen=True)
class StopMaster:
    """An administrator has called `shutdown`."""

    reason: str


@dataclass(frozen=True)
class GrantsPresented:
    """A caller has presented grants, of which some may be `refused`; its rights have changed."""

    name: str
    refused: tuple[str, ...] = ()


@dataclass(frozen=True)
class GrantsDeposited:
    """The authority has deposited `count` grants for the keys `holders`: notify these nodes."""

    by: str
    holders: frozenset[bytes]
    count: int


@dataclass(frozen=True)
class RevocationsChanged:
    """A newer revocation list, delivered by `by`, is in force: enforce it and distribute it."""

    by: str


@dataclass(frozen=True)
class DomainsChanged:
    """A newer list of domains, delivered by `by`, is in force: enforce it and distribute it."""

    by: str


@dataclass(frozen=True)
class Administered:
    """An administrative change to the master or to another node's registrations: for the audit."""

    by: str
    what: str


@dataclass(frozen=True)
class Denied:
    """A caller lacks a right on a name: for the denial log."""

    node: str
    right: Right
    name: str


@dataclass(frozen=True)
class CallDenied:
    """A call was refused by rossec, alone or within a multicall: for the audit.

    Attributes:
        node: the caller, for people.
        taken_by: the node that registered the address, if that was the reason.
        missing: the right that is missing, and the name it is missing on, if that was the reason.
        certified: the name that the caller's connection proved; `wildcard`: it has a tail.
    """

    node: str
    method: str
    status: str
    taken_by: NodeRef | None = None
    missing: tuple[Right, str] | None = None
    certified: str = ""
    wildcard: bool = False


@dataclass(frozen=True)
class PersistParameter:
    """Write this change to the journal, so that it survives a restart."""

    change: ParameterChange


MasterEvent = (
    Event
    | ParameterChanged
    | PersistParameter
    | StopMaster
    | GrantsPresented
    | GrantsDeposited
    | RevocationsChanged
    | DomainsChanged
    | Denied
    | CallDenied
    | Administered
    | TypeContradicted
)


class Reply(NamedTuple):
    """ROS's code, status and value, and the events to deliver."""

    value: object
    status: str = ""
    code: int = 1
    events: tuple[MasterEvent, ...] = ()


class CallRequest(NamedTuple):
    """One call whose arguments are checked and resolved; `arguments[0]` is the caller_id.

    `is_local`: the caller is on the master's host.
    """

    caller: Caller
    arguments: tuple[object, ...]
    now: int
    is_local: bool = True

    def text(self, index: int) -> str:
        """An argument that was checked to be text."""
        value = self.arguments[index]
        if not isinstance(value, str):
            raise TypeError(f"argument {index} is not text")
        return value

    def binary(self, index: int) -> bytes:
        """An argument that was checked to be bytes."""
        value = self.arguments[index]
        if not isinstance(value, bytes):
            raise TypeError(f"argument {index} is not bytes")
        return value

    def node(self, index: int) -> NodeRef:
        """The caller with the slave API URI that is this argument."""
        return NodeRef(self.caller.name, self.text(index), self.caller.thumbprint)


Steps = Generator[None, None, Reply]
"""A filtered query: yields where other calls may be answered, returns the reply."""

Handler = Callable[[CallRequest], Reply | Steps]


@dataclass(frozen=True)
class Method:
    """An entry of the method table: checks of the arguments after caller_id, default, handler."""

    checks: tuple[Check, ...]
    default: object
    handler: Handler


Methods = Mapping[str, Method]
