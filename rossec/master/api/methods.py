"""What a master method is: its arguments, its default, its handler, and what a handler returns."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from grants.model import Right
from rossec.master.api.arguments import Check
from rossec.master.rights.access_rules import Caller
from rossec.master.state.parameter_journal import ParameterChange
from rossec.master.state.registry import Event, NodeRef


@dataclass(frozen=True)
class ParameterChanged:
    """Tell one subscriber that a parameter has this value now ({}: unset)."""

    node: NodeRef
    key: str
    value: object


@dataclass(frozen=True)
class StopMaster:
    """An administrator asked the master to end."""

    reason: str


@dataclass(frozen=True)
class GrantsPresented:
    """A caller has handed in grants; what it may do has changed, except for those refused."""

    name: str
    refused: tuple[str, ...] = ()


@dataclass(frozen=True)
class RevocationsChanged:
    """A newer revocation list, which `by` brought, is in force: enforce it and pass it on."""

    by: str


@dataclass(frozen=True)
class Administered:
    """Somebody changed what the master does, or what another node registered: for the audit."""

    by: str
    what: str


@dataclass(frozen=True)
class Denied:
    """A caller lacks a right on a name: what a complain log is made of."""

    node: str
    right: Right
    name: str


@dataclass(frozen=True)
class CallDenied:
    """A call was refused by rossec, alone or within a multicall: for the audit.

    `taken_by` is the node that has the address, if that was the reason.
    """

    node: str
    method: str
    status: str
    taken_by: NodeRef | None = None


@dataclass(frozen=True)
class PersistParameter:
    """A change to write down, so that it survives the master."""

    change: ParameterChange


MasterEvent = (
    Event
    | ParameterChanged
    | PersistParameter
    | StopMaster
    | GrantsPresented
    | RevocationsChanged
    | Denied
    | CallDenied
    | Administered
)


class Reply(NamedTuple):
    """ROS's code, status and value, and the events to deliver."""

    value: object
    status: str = ""
    code: int = 1
    events: tuple[MasterEvent, ...] = ()


class CallRequest(NamedTuple):
    """One call whose arguments are checked and resolved; `arguments[0]` is the caller_id.

    `is_local`: it comes from the master's own host.
    """

    caller: Caller
    arguments: tuple[object, ...]
    now: int
    is_local: bool = True

    def text(self, index: int) -> str:
        """An argument whose check returned text."""
        value = self.arguments[index]
        if not isinstance(value, str):
            raise TypeError(f"argument {index} is not text")
        return value

    def binary(self, index: int) -> bytes:
        """An argument whose check returned bytes."""
        value = self.arguments[index]
        if not isinstance(value, bytes):
            raise TypeError(f"argument {index} is not bytes")
        return value

    def node(self, index: int) -> NodeRef:
        """The caller with the slave API URI that is this argument."""
        return NodeRef(self.caller.name, self.text(index), self.caller.thumbprint)


Steps = Generator[None, None, Reply]
"""A query over all there is: yields wherever others may have their turn, returns the reply."""

Handler = Callable[[CallRequest], Reply | Steps]


@dataclass(frozen=True)
class Method:
    """One row of the method table: checks of the arguments after caller_id, default, handler."""

    checks: tuple[Check, ...]
    default: object
    handler: Handler


Methods = Mapping[str, Method]
