"""The types of a master method: its arguments, default and handler, and what handlers return. Pure.

Long calls are processed in turns of limited time, so that they do not delay others. A count would
not limit the time, since one call may cost ten thousand times as much as another. A generator
yields where it can be suspended; `expired`, which reads the caller's clock, says when.
"""

from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeAlias, TypeVar

from grants.model import Right
from rossec.master.api.arguments import Check
from rossec.master.rights.caller import Caller, RecentDenials
from rossec.master.rights.held_grants import Deposits
from rossec.master.rights.publisher_views import AliasPublishers
from rossec.master.rights.statements import TrustState
from rossec.master.state import graph, imported_facts, journals
from rossec.master.state.forwarded_ports import ForwardedPorts
from rossec.master.state.imports import Imports
from rossec.master.state.parameters import SIZE_LIMIT, Parameters
from rossec.master.state.registry import Event, NodeRef


@dataclass
class MasterTables:
    """All that one master knows; what the shell adds is `rossec.master.server.effects.MasterState`."""

    name: str  # the certified name; ADMIN on the master is a right on it
    trust: TrustState
    imports: Imports
    parameters: Parameters = field(default_factory=Parameters)
    parameter_bytes: int = SIZE_LIMIT  # of all parameters together
    deposits: Deposits = field(default_factory=Deposits)  # by default none is accepted
    recent_denials: RecentDenials = field(default_factory=RecentDenials)
    forwarded_ports: ForwardedPorts = field(default_factory=ForwardedPorts)

    def __post_init__(self) -> None:
        self.registry = self.imports.registry
        self.graph = graph.Graph(self.registry, self.imports)
        self.aliases = AliasPublishers(self.graph, self.trust.caller_of)


@dataclass(frozen=True)
class ParameterChanged:
    """Notify one subscriber that a parameter has this value now ({}: unset)."""

    node: NodeRef
    key: str
    value: object


@dataclass(frozen=True)
class StopMaster:
    reason: str


@dataclass(frozen=True)
class CallerPresentedGrants:
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
    """A call was refused by rossec, alone or within a multicall: for the audit."""

    node: str  # the caller, for people
    method: str
    status: str
    taken_by: NodeRef | None = None  # the node that registered the address, if that was the reason
    # the right that is missing, and the name it is missing on, if that was the reason
    missing: tuple[Right, str] | None = None
    certified: str = ""  # the name that the caller's connection proved; `wildcard`: it has a tail
    wildcard: bool = False


@dataclass(frozen=True)
class PersistParameter:
    """Write this change to the journal, so that it survives a restart."""

    change: journals.ParameterChange


MasterEvent = (
    Event
    | ParameterChanged
    | PersistParameter
    | StopMaster
    | CallerPresentedGrants
    | GrantsDeposited
    | RevocationsChanged
    | DomainsChanged
    | Denied
    | CallDenied
    | Administered
    | imported_facts.TypeContradicted
)


class Reply(NamedTuple):
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
        value = self.arguments[index]
        if not isinstance(value, str):
            raise TypeError(f"argument {index} is not text")
        return value

    def binary(self, index: int) -> bytes:
        value = self.arguments[index]
        if not isinstance(value, bytes):
            raise TypeError(f"argument {index} is not bytes")
        return value

    def binaries(self, index: int) -> list[bytes]:
        value = self.arguments[index]
        return [item for item in value if isinstance(item, bytes)] if isinstance(value, list) else []

    def node(self, index: int) -> NodeRef:
        return NodeRef(self.caller.name, self.text(index), self.caller.thumbprint)


# A filtered query: yields where other calls may be answered, returns the reply
Steps = Generator[None, None, Reply]
Handler = Callable[[CallRequest], Reply | Steps]


@dataclass(frozen=True)
class Method:
    checks: tuple[Check, ...]
    default: object
    handler: Handler


Methods = Mapping[str, Method]

TURN: Final = 0.005  # seconds that one call may occupy the loop

TurnExpired = Callable[[], bool]  # Whether the turn has expired

T = TypeVar("T")


def collected(items: Iterable[T | None], at_once: int) -> Generator[None, None, list[T]]:
    """The items that are not None; yields after so many of all, as each costs time."""
    found: list[T] = []
    for number, item in enumerate(items, 1):
        if item is not None:
            found.append(item)
        if not number % at_once:
            yield
    return found


class CallOutcome(NamedTuple):
    answer: object
    events: tuple[MasterEvent, ...] = ()


Work: TypeAlias = Generator[None, None, CallOutcome]  # A call that may take many turns


class TurnClock:
    """Begins turns of `length` seconds by a monotonic clock."""

    def __init__(self, clock: Callable[[], float], length: float = TURN) -> None:
        self._clock = clock
        self._length = length

    def begin(self) -> TurnExpired:
        end = self._clock() + self._length
        return lambda: self._clock() >= end


def advance(work: Work, expired: TurnExpired) -> CallOutcome | None:
    """Run `work` for one turn; None: it is not finished."""
    try:
        while True:
            next(work)
            if expired():
                return None
    except StopIteration as end:
        outcome: CallOutcome = end.value
        return outcome
