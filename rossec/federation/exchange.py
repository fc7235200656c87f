"""Signed lists between masters: a newer one of the other side is taken, an older one is replaced.

A shell. Nothing is trusted here: each list carries its authority's signature, and who holds the
newer one is found by trying to take the other's. A master that was restored from a backup gets the
newest list from whichever master it meets first.
"""

import asyncio
from collections.abc import Generator
from typing import Final, TypeVar

from ca.certificates import Identity
from ca.errors import DomainsRefused, RevocationRefused
from ca.revocation.state import digest
from ca.revocation.tree import is_tree
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.federation.answers import SiteChange
from rossec.federation.foreign import MAX_PRESENTED
from rossec.federation.own import OwnMaster
from rossec.master.api.methods import DomainsChanged, RevocationsChanged
from rossec.net.rpc.client import RpcClient
from rossec.ros.names import DOMAINS, PRESENT_GRANTS, UPDATE_DOMAINS
from rossec.ros.xmlrpc import Fault

_SINCE: Final = "rossec.revocationsSince"
_T = TypeVar("_T")
_UNKNOWN: Final = (AnswerRefused, Fault)  # also of a master that does not know the call


async def in_turns(steps: Generator[None, None, _T]) -> _T:
    """What the steps return; other calls are answered between two of them."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: _T = end.value
            return result
        await asyncio.sleep(0)


def held_revocations(own: OwnMaster) -> bytes:
    """The digest of the revocation list held; empty: there is none."""
    data = own.state.trust.list_data
    return digest(data) if data else b""


async def present_own(client: RpcClient, own: OwnMaster) -> None:
    """Show the grants of the own domain: a master needs `param-get` as any node does."""
    if tokens := list(own.grants())[:MAX_PRESENTED]:
        await client.ask(PRESENT_GRANTS, own.name, tokens)


async def settle(
    client: RpcClient, own: OwnMaster, peer: Identity, answer: SiteChange | None = None
) -> None:
    """Settle both lists; after an answer, those whose digests in it are others than here.

    Raises:
        CAError, RossecError: as `settle_revocations`.
    """
    if answer is None or answer.revocations != held_revocations(own):
        await settle_revocations(client, own, peer)
    if answer is None or answer.domains != own.state.trust.domains.digest():
        await settle_domains(client, own, peer)


async def settle_revocations(client: RpcClient, own: OwnMaster, peer: Identity) -> None:
    """Of both revocation lists the newer one is in force at both masters afterwards.

    Raises:
        CAError, RossecError: the other master's answer is malformed, or it refuses the newer list.
    """
    held = own.state.trust.list_data
    match await client.ask(_SINCE, own.name, digest(held)):
        case [bytes() as theirs, bytes()]:
            pass
        case _:
            raise AnswerMalformed("a master's answer without a revocation list")
    if theirs in (b"", held) or await _take(client, own, peer, theirs) or not held:
        return
    entries = own.state.trust.tree_entries
    if is_tree(held) and entries:
        await client.ask("rossec.updateRevocationTree", own.name, held, entries)
    elif not is_tree(held):
        await client.ask("rossec.updateRevocations", own.name, held)


async def _take(client: RpcClient, own: OwnMaster, peer: Identity, theirs: bytes) -> bool:
    """Take the other master's list; returns whether it is in force now."""
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
    """Of both lists of foreign domains the newer one is in force at both masters afterwards.

    A master that does not know the call has no such list, and gets none.

    Raises:
        CAError, RossecError: as `settle_revocations`.
    """
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
