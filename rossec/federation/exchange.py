"""What masters that follow each other exchange beside facts: signed lists, parameters. A shell.

Nothing is trusted here: each list carries its authority's signature, and who holds the newer one is
found by trying to take the other's; an older one is replaced. So a master that was restored from a
backup gets the newest list from whichever master it meets first. The revocations of a foreign
domain are judged by `DomainTrust`, and passed on to the own nodes, which judge them again.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from ca.bounded import Newest
from ca.certificates import Identity
from ca.domains import ListedDomain
from ca.errors import DomainsRefused, RevocationRefused, RevocationsStale
from ca.names import pattern_covers
from ca.revocation.lists import digest, is_tree
from grants.errors import GrantError
from grants.model import Right
from grants.token import peek
from rossec.channel.edhoc.credentials import Verify
from rossec.errors import AnswerMalformed, AnswerRefused, SiteRefused
from rossec.federation.settings import SiteSettings
from rossec.federation.site_state import SiteChange
from rossec.master.api.methods import DomainsChanged, RevocationsChanged
from rossec.master.server import Effects, MasterState
from rossec.master.state.imported_facts import Site
from rossec.net.aio import SecureContext
from rossec.net.rpc import RpcClient
from rossec.ros.names import DOMAINS, PRESENT_GRANTS, UPDATE_DOMAINS
from rossec.ros.xmlrpc import Fault

MAX_CHAINS: Final = 256


class Chains:
    # The handshake gives the identity alone; nodes verify a foreign master's word themselves, so its chain
    # is kept.
    def __init__(self) -> None:
        self._chains: Newest[bytes, tuple[bytes, ...]] = Newest(MAX_CHAINS)

    def recording(self, verify: Verify[Identity]) -> Verify[Identity]:
        def verified(chain: tuple[bytes, ...], now: int) -> Identity:
            identity = verify(chain, now)
            self._chains[identity.thumbprint] = chain
            return identity

        return verified

    def of(self, identity: Identity) -> tuple[bytes, ...]:
        return self._chains.get(identity.thumbprint, ())


@dataclass(frozen=True)
class OwnMaster:
    """The master that follows."""

    state: MasterState
    effects: Effects
    context: SecureContext[Identity]  # its own identity, to dial with; its `verify` is that of `chains`
    mirror: Callable[[Site, dict[str, object]], None]  # takes over parameters; raises ImportRefused
    drop_mirror: Callable[[str], None]  # forgets those of the site with this label
    chains: Chains = field(default_factory=Chains)  # the certificates by which peers were verified
    grants: Callable[[], Sequence[bytes]] = tuple  # those in its home, which another master wants to see

    @property
    def name(self) -> str:
        return self.state.name


LONGEST_FOREIGN: Final = 8.0  # seconds between two words of a foreign master that refuses
FOREIGN_EVERY: Final = 10.0  # seconds between two words of a foreign master
APART: Final = 1.0  # seconds between two lists: each is sent to every own node, which saves it
MAX_PRESENTED: Final = 64
_PROOFS_AT_ONCE: Final = 64


class ForeignLists:
    """Keeps the revocations of one foreign domain fresh, on the connection that is followed."""

    def __init__(self, own: OwnMaster, label: str) -> None:
        self._own = own
        self._label = label
        self._asked_at = self._changed_at = 0.0

    async def greet(self, client: RpcClient, peer: Identity) -> None:
        await self.fetch(client, peer)
        if tokens := self._tokens():
            await client.ask(PRESENT_GRANTS, self._own.name, tokens)

    async def listen(
        self, client: RpcClient, peer: Identity, changed: asyncio.Event, check: Callable[[], None]
    ) -> None:
        # `check` raises when the peer must go; it is called as soon as the own lists have `changed`.
        while not self.may_see(peer.certified_name):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LONGEST_FOREIGN):
                    await changed.wait()
            changed.clear()
            check()
            await self.fetch(client, peer)

    def may_see(self, master: str) -> bool:
        now = self._own.state.now()
        held = (peek(token) for token in self._tokens())
        return any(each.covers(Right.GRAPH, master) and now < each.expires for each in held)

    async def keep_fresh(self, client: RpcClient, peer: Identity, theirs: bytes) -> None:
        held = self._own.state.trust.domains.word(self._listed().entry.domain)
        if theirs != held.digest():
            await asyncio.sleep(self._changed_at + APART - time.monotonic())
            self._changed_at = time.monotonic()
            await self.fetch(client, peer)
        elif time.monotonic() - self._asked_at >= FOREIGN_EVERY:
            await self.fetch(client, peer)

    async def fetch(self, client: RpcClient, peer: Identity) -> None:
        # Fetch the word, and the list unless it is held; raises as `greet`.
        own, domain = self._own, self._listed().entry.domain
        domains = own.state.trust.domains
        held = domains.word(domain).revocations
        match await client.ask("rossec.revocationsSince", own.name, digest(held)):
            case [bytes() as revocations, bytes() as timestamp]:
                pass
            case _:
                raise AnswerMalformed("a foreign master's answer without revocations")
        self._asked_at = time.monotonic()
        chain = own.chains.of(peer)
        try:
            own.effects.take_foreign(domain, revocations, timestamp, chain)
        except RevocationsStale:  # of a tree: its own key has no proof yet
            if not await self._prove(client, domain):
                raise
            own.effects.take_foreign(domain, b"", timestamp, chain)
        await self._prove(client, domain)

    async def _prove(self, client: RpcClient, domain: str) -> int:
        domains, taken = self._own.state.trust.domains, 0
        wanted = domains.wanted_proofs(domain)[:_PROOFS_AT_ONCE]
        if not wanted:
            return 0
        answer = await client.ask("rossec.revocationProofs", self._own.name, wanted)
        proofs = answer if isinstance(answer, list) else []
        for entry, proof in zip(wanted, proofs, strict=False):
            if isinstance(proof, bytes) and proof:
                try:
                    domains.add_proof(domain, entry, proof)
                except RevocationRefused:
                    continue
                taken += 1
        return taken

    def _tokens(self) -> list[bytes]:
        domain, found = self._listed().entry.domain, list[bytes]()
        for token in self._own.grants():
            with contextlib.suppress(GrantError):
                if peek(token).domain == domain:
                    found.append(token)
        return found[:MAX_PRESENTED]

    def _listed(self) -> ListedDomain:
        listed = self._own.state.trust.domains.anchors.listed(self._label)
        if listed is None:
            raise SiteRefused(f"{self._label} is not a domain that is trusted here", "rossec domain list")
        return listed


_T = TypeVar("_T")
_UNKNOWN: Final = (AnswerRefused, Fault)  # also of a master that does not know the call


async def in_turns(steps: Generator[None, None, _T]) -> _T:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: _T = end.value
            return result
        await asyncio.sleep(0)


async def settle(client: RpcClient, own: OwnMaster, peer: Identity, answer: SiteChange | None = None) -> None:
    if answer is None or answer.revocations != own.state.trust.list_digests()[0]:
        await settle_revocations(client, own, peer)
    if answer is None or answer.domains != own.state.trust.domains.digest():
        await settle_domains(client, own, peer)


async def settle_revocations(client: RpcClient, own: OwnMaster, peer: Identity) -> None:
    # Who holds the newer list is found by trying to take theirs: its number is believed only when signed.
    held = own.state.trust.list_data
    match await client.ask("rossec.revocationsSince", own.name, digest(held)):
        case [bytes() as theirs, bytes()]:
            pass
        case _:
            raise AnswerMalformed("a master's answer without a revocation list")
    if theirs in (b"", held) or await _take(client, own, peer, theirs) or not held:
        return
    # A master that was restored from a backup gets the newest from whichever it meets first.
    entries = own.state.trust.tree_entries
    if is_tree(held) and entries:
        await client.ask("rossec.updateRevocationTree", own.name, held, entries)
    elif not is_tree(held):
        await client.ask("rossec.updateRevocations", own.name, held)


async def _take(client: RpcClient, own: OwnMaster, peer: Identity, theirs: bytes) -> bool:
    trust, now = own.state.trust, own.state.now()
    try:
        if is_tree(theirs):
            entries = await client.ask("rossec.revocationEntries", own.name)
            if not isinstance(entries, bytes):
                raise AnswerMalformed("a master's answer without entries of a tree")
            newer = await in_turns(trust.take_tree(theirs, entries, now))
        else:
            newer = trust.update(theirs, now)
    except (RevocationRefused, *_UNKNOWN):  # older, most often: then it gets ours
        return False
    if newer:
        own.effects.deliver(RevocationsChanged(peer.name))
    return True


async def settle_domains(client: RpcClient, own: OwnMaster, peer: Identity) -> None:
    # Of both lists of foreign domains the newer one is in force at both masters afterwards. A master that
    # does not know the call has no such list, and gets none.
    domains = own.state.trust.domains
    try:
        theirs = await client.ask(DOMAINS, own.name, domains.digest())
    except _UNKNOWN:
        return
    if not isinstance(theirs, bytes):
        raise AnswerMalformed("a master's answer without a list of domains")
    if theirs:
        try:
            newer = own.state.trust.update_domains(theirs)
        except DomainsRefused:  # older, most often: then it gets ours
            newer = None
        if newer:
            own.effects.deliver(DomainsChanged(peer.name))
        if newer is not None:
            return
    if domains.anchors.data:
        await client.ask(UPDATE_DOMAINS, own.name, domains.anchors.data)


MIRRORED_EVERY: Final = 5.0  # seconds between two readings
MAX_NAMES: Final = 4096  # of one site
_AT_ONCE: Final = 128


class Mirroring:
    """Reads the parameters that `settings` names, on the connection that is followed. The copy is set at its
    origin only; the other master decides by grants what may be read (`param-get`).
    """

    def __init__(self, own: OwnMaster, settings: SiteSettings) -> None:
        self._own = own
        self._settings = settings
        self._read_at = -MIRRORED_EVERY
        self._names_held: list[str] = []
        self.mirrored = 0  # how many parameters there are

    async def keep(self, client: RpcClient) -> None:
        if not self._settings.parameters or time.monotonic() - self._read_at < MIRRORED_EVERY:
            return
        self._read_at = time.monotonic()
        names = await self._names(client)
        tree: dict[str, Any] = {}
        self.mirrored = 0
        for begin in range(0, len(names), _AT_ONCE):
            for name, value in await self._values(client, names[begin : begin + _AT_ONCE]):
                _put(tree, name, value)
                self.mirrored += 1
        if not all(map(self._is_taken, names)):  # there is another list meanwhile: read again
            self._read_at = -MIRRORED_EVERY
            return
        self._own.mirror(self._settings.site, tree)
        self._names_held = names

    def judge(self) -> None:
        # There is another list of domains: forget what is not taken from that domain any more.
        if any(not self._is_taken(name) for name in self._names_held):
            self.drop()

    def drop(self) -> None:
        self.mirrored, self._read_at, self._names_held = 0, -MIRRORED_EVERY, []
        self._own.drop_mirror(self._settings.label)

    async def _names(self, client: RpcClient) -> list[str]:
        found = await client.ask("getParamNames", self._own.name)
        if not isinstance(found, list):
            raise AnswerMalformed("a master's answer without names of parameters")
        texts = [each for each in found if isinstance(each, str) and self._is_taken(each)]
        patterns = self._settings.parameters
        names = [each for each in texts if any(pattern_covers(pattern, each) for pattern in patterns)]
        if len(names) > MAX_NAMES:
            raise AnswerRefused(
                f"{self._settings.label} has {len(names)} parameters of these patterns, not"
                f" {MAX_NAMES} at most",
                "mirror fewer: `rossec federation param`",
            )
        return sorted(names)

    def _is_taken(self, name: str) -> bool:
        label = self._settings.domain
        taken = self._own.state.trust.domains.imported(label) if label else None
        return taken is None or taken.covers(Right.PARAM_GET, name)

    async def _values(self, client: RpcClient, names: list[str]) -> list[tuple[str, Any]]:
        calls = [{"methodName": "getParam", "params": [self._own.name, name]} for name in names]
        answers = await client.call("system.multicall", calls)
        if not isinstance(answers, list) or len(answers) != len(names):
            raise AnswerMalformed("a master's answer without values of parameters")
        found: list[tuple[str, Any]] = []
        for name, answer in zip(names, answers, strict=True):
            match answer:
                case [[1, str(), value]]:
                    found.append((name, value))
                case _:
                    pass  # it was unset meanwhile, or may not be read
        return found


def _put(tree: dict[str, Any], name: str, value: object) -> None:
    *path, last = name.strip("/").split("/")
    for each in path:
        inner = tree.setdefault(each, {})
        if not isinstance(inner, dict):
            raise AnswerMalformed("a parameter below a value")
        tree = inner
    tree[last] = value
