"""Callers with chosen rights and a fake of the statements, for the tests of the pure folders."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from grants.decision import Reach
from grants.errors import GrantError, GrantMissing
from grants.model import Permission, Right
from rossec.master.api.dispatch import MULTICALL, MasterApi, Multicall
from rossec.master.api.methods import CallOutcome, MasterEvent, MasterTables, TurnExpired, Work, advance
from rossec.master.rights.caller import Caller, CertifiedPeer
from rossec.master.rights.held_grants import Renewed, VerifiedGrants
from rossec.master.rights.renewals import RenewalAnswer
from rossec.master.rights.revocation_lists import HeldLists, ListStatus
from rossec.master.rights.statements import TrustState
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry

ALL = Right(255)


def caller(name: str, rights: Mapping[str, Right] | None = None, *, wildcard: bool = False) -> Caller:
    """A caller with rights on exact names and below `/ns/**`."""
    held = Reach(Permission(pattern, right) for pattern, right in (rights or {}).items())
    return Caller(name, name.encode(), held, refuse, wildcard)


def refuse(_right: Right, _name: str) -> None:
    raise GrantMissing("no grant covers it")


class Everything(Reach):
    """Covers every name, also the root, which no pattern covers."""

    def covers(self, right: Right, name: str) -> bool:
        return True


def everything(name: str) -> Caller:
    return Caller(name, name.encode(), Everything([Permission("/**", ALL)]), refuse)


def anonymous(name: str, rights: Mapping[str, Right] | None = None) -> Caller:
    """A caller with a wildcard tail."""
    return caller(name, rights or {"/**": ALL}, wildcard=True)


def never_expires() -> bool:
    return False


def run_to_end(work: Work) -> CallOutcome:
    while (outcome := advance(work, never_expires)) is None:
        pass
    return outcome


def master_api(
    registry: Registry,
    statements: TrustState,
    *,
    name: str = "/master",
    uri: str = "http://m:1/",
    pid: int = 7,
    instance: str = "",
    connected: Callable[[], Iterable[CertifiedPeer]] = tuple,
    imports: Imports | None = None,
    **tables: Any,
) -> MasterApi:
    """The API of a master with these registrations; `tables`: others of `MasterTables`."""
    found = MasterTables(name, statements, Imports(registry) if imports is None else imports, **tables)
    return MasterApi(found, uri=uri, pid=pid, instance=instance, connected=connected)


def call_api(
    api: MasterApi, method: str, params: Sequence[object], who: Caller, now: int, *, is_local: bool = True
) -> CallOutcome:
    """Answer one call to its end, as the server does in turns."""
    if method != MULTICALL:
        begun = api.begin(method, params, who, now, is_local=is_local)
        return begun if isinstance(begun, CallOutcome) else run_to_end(begun)
    multicall, events = Multicall(params), list[MasterEvent]()
    while not multicall.done:
        events += step(api, multicall, who, now, is_local=is_local)
    return CallOutcome(multicall.answer, tuple(events))


def step(
    api: MasterApi,
    multicall: Multicall,
    who: Caller,
    now: int = 0,
    *,
    is_local: bool = True,
    expired: TurnExpired = never_expires,
) -> tuple[MasterEvent, ...]:
    """Process elements of a multicall for one turn."""
    return multicall.step(partial(api.begin, caller=who, now=now, is_local=is_local), expired)


@dataclass
class FakeStatements(TrustState):
    """A `TrustState` that verifies nothing: b"forged" is refused, everything else accepted."""

    callers: dict[str, Caller] = field(default_factory=dict)
    lists: list[bytes] = field(default_factory=list)
    presented: list[bytes] = field(default_factory=list)
    held_lists: HeldLists = field(default_factory=HeldLists)

    def caller_of(self, peer: CertifiedPeer, now: int) -> Caller | None:
        known = self.callers.get(peer.name)
        return known if known is not None and known.thumbprint == peer.thumbprint else None

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> VerifiedGrants:
        good = [token for token in tokens if token != b"forged"]
        self.presented += good
        return VerifiedGrants(len(self.presented), ("forged",) * (len(tokens) - len(good)))

    def has_presented(self, holder: bytes, grant_id: bytes) -> bool:
        return grant_id in self.presented

    def revoked(self) -> frozenset[bytes]:
        return frozenset({b"one", b"two"})

    def pertaining(self, caller: Caller, names: Iterable[str]) -> Generator[None, None, frozenset[bytes]]:
        yield
        return frozenset({b"one"}) if "/t" in names else frozenset()

    def renew(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Renewed:
        good = [b"" if token == b"forged" else b"renewed " + token for token in tokens]
        return Renewed(tuple(good), ("forged",) * good.count(b""))

    def renew_identity(self, caller: Caller, request: bytes, now: int) -> RenewalAnswer:
        if request == b"forged":
            raise GrantError("not signed by the old key")
        if request == b"later":
            return RenewalAnswer(b"", "the authority is asked")
        return RenewalAnswer(b"bundle of " + request, "identity renewed")

    def update_delegation(self, data: bytes) -> bool:
        if data == b"forged":
            raise GrantError("the signature is not the authority's")
        return data == b"newer"

    def current(self, now: int) -> tuple[bytes, bytes]:
        return (self.lists[-1], b"stamp") if self.lists else (b"", b"")

    def take_tree(self, data: bytes, entries: bytes, now: int) -> Generator[None, None, bool]:
        yield
        return self.update(data + entries, now)

    def proofs(self, entries: Sequence[bytes]) -> list[bytes]:
        return [b"proof of " + entry for entry in entries]

    def list_digests(self) -> tuple[bytes, bytes]:
        return (self.lists[-1], b"domains") if self.lists else (b"", b"")

    @property
    def list_number(self) -> tuple[int, int]:
        return 1, len(self.lists)

    def trust_status(self, connected: Iterable[CertifiedPeer], now: int) -> ListStatus:
        return self.held_lists.trust_status(connected, self.lists[-1], now)

    def revocations_for(self, peer: CertifiedPeer, now: int) -> tuple[bytes, bytes]:
        data, stamp = self.current(now)
        return (b"" if self.held_lists.holds(peer, data) else data), stamp

    def update(self, data: bytes, now: int) -> bool:
        if data == b"forged":
            raise GrantError("the signature is not the authority's")
        newer = not self.lists or data > self.lists[-1]
        if newer:
            self.lists.append(data)
        return newer
