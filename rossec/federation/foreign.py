"""What a foreign master is asked for beside its graph: its domain's revocations. A shell.

Its list is fetched when the digest differs, its word that the list is still the newest every ten
seconds; both are judged by `DomainTrust`, and passed on to the own nodes, which judge them again.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity
from ca.domains.anchors import ListedDomain
from ca.errors import RevocationRefused, RevocationsStale
from ca.revocation.state import digest
from grants.errors import GrantError
from grants.model import Right
from grants.token import peek
from rossec.errors import AnswerMalformed, SiteRefused
from rossec.federation.own import OwnMaster
from rossec.net.rpc.client import RpcClient
from rossec.ros.names import PRESENT_GRANTS

LONGEST_FOREIGN: Final = 8.0  # seconds between two words of a foreign master that refuses
EVERY: Final = 10.0  # seconds between two words of a foreign master
APART: Final = 1.0  # seconds between two lists: each is sent to every own node, which saves it
MAX_PRESENTED: Final = 64
_PROOFS_AT_ONCE: Final = 64


class ForeignLists:
    """Keeps the revocations of one foreign domain fresh, on the connection that is followed.

    Args:
        own: the master that follows.
        label: of the domain.
    """

    def __init__(self, own: OwnMaster, label: str) -> None:
        self._own = own
        self._label = label
        self._asked_at = self._changed_at = 0.0

    async def greet(self, client: RpcClient, peer: Identity) -> None:
        """The first word, then the grants of that domain that this master holds.

        Raises:
            SiteRefused: the domain is not listed any more.
            CAError, RossecError: its word is refused, or there is none.
        """
        await self.fetch(client, peer)
        if tokens := self._tokens():
            await client.ask(PRESENT_GRANTS, self._own.name, tokens)

    async def listen(
        self, client: RpcClient, peer: Identity, changed: asyncio.Event, check: Callable[[], None]
    ) -> None:
        """Hear what is revoked there, of a master that shows nothing; until there is a grant.

        `check` raises when the peer must go; it is called as soon as the own lists have `changed`.

        Raises:
            SiteRefused, CAError, RossecError: as `greet`, and what `check` does.
        """
        while not self.may_see(peer.certified_name):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LONGEST_FOREIGN):
                    await changed.wait()
            changed.clear()
            check()
            await self.fetch(client, peer)

    def may_see(self, master: str) -> bool:
        """Whether this master holds a grant, unverified, that says it may see the graph there."""
        now = self._own.state.now()
        held = (peek(token) for token in self._tokens())
        return any(each.covers(Right.GRAPH, master) and now < each.expires for each in held)

    async def keep_fresh(self, client: RpcClient, peer: Identity, theirs: bytes) -> None:
        """Fetch where the digest `theirs` is another, or the last word is old; raises likewise."""
        held = self._own.state.trust.domains.word(self._listed().entry.domain)
        if theirs != held.digest():
            await asyncio.sleep(self._changed_at + APART - time.monotonic())
            self._changed_at = time.monotonic()
            await self.fetch(client, peer)
        elif time.monotonic() - self._asked_at >= EVERY:
            await self.fetch(client, peer)

    async def fetch(self, client: RpcClient, peer: Identity) -> None:
        """Fetch the word, and the list unless it is held; raises as `greet`."""
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
        """Fetch the proofs of a foreign tree that are wanted; returns how many were taken."""
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
        """The grants of that domain that this master holds, as far as they are shown."""
        domain = self._listed().entry.domain
        return [each for each in self._own.grants() if _domain_of(each) == domain][:MAX_PRESENTED]

    def _listed(self) -> ListedDomain:
        listed = self._own.state.trust.domains.anchors.listed(self._label)
        if listed is None:
            raise SiteRefused(
                f"{self._label} is not a domain that is trusted here", "rossec domain list"
            )
        return listed


def _domain_of(grant: bytes) -> str:
    """The domain a grant is of, unverified; empty: it is none."""
    try:
        return peek(grant).domain
    except GrantError:
        return ""
