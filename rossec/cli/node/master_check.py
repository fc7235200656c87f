"""What `rossec doctor` learns from the master: who answers there, the clock, and what is revoked.

All of it comes over a connection on which the master proved its identity, and both things that are
relied on are signed: the list by the authority, the timestamp by the master, in the second in which
it answers. So the timestamp shows how far this host's clock is off. Of an unauthenticated host no
time is taken.
"""

from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

from ca import svid
from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import (
    CertificateExpired,
    CertificateNotYetValid,
    HintedError,
    RevocationsStale,
    Revoked,
)
from ca.revocation.state import (
    SKEW,
    RevocationList,
    Revocations,
    Timestamp,
    open_statement,
    open_timestamp,
)
from grants.model import Grant
from rossec import clock
from rossec.channel.suite_selection import post_quantum
from rossec.cli.node.address_check import Outcome, check_node_addresses
from rossec.cli.shared.context import Environment, now
from rossec.cli.shared.master import (
    REVOCATIONS,
    anew,
    find_master,
    is_of_revoked,
    revoked_text,
)
from rossec.environment import OWN_MASTER, own_master
from rossec.errors import ChannelError, ConfigurationError
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, as_master, connect
from rossec.net.rpc.client import RpcClient
from rossec.participant.grant_renewal import MasterCall
from rossec.participant.revocation_proofs import MAX_PER_CALL, prove
from rossec.ros import settings
from rossec.saved_domains import DomainFiles

_MINUTE: Final = 60  # seconds that a connection may last whose certificate is out of its time
_NO_LIST: Final = "the master has no revocation list"


async def check_master(
    environment: Environment, home: NodeHome, grants: Iterable[Grant]
) -> AsyncIterator[Outcome]:
    """Ask the master as the node in `home`, which holds `grants`.

    Raises:
        HintedError: it is out of reach, or not the master; the node is revoked.
    """
    uri = await find_master(environment, home)
    judge = _Judge(home)
    stream = await _connect(environment, home, uri, judge)
    try:
        client = RpcClient(stream)

        async def call(method: str, *parameters: object) -> object:
            return await client.ask(method, home.name, *parameters)

        begun = clock.time()
        data, stamp = _opened(home, stream.peer, await call(REVOCATIONS))
        yield (said := describe_offset(stamp.issued, begun, clock.time()))
        if isinstance(said, HintedError):
            return  # nothing that has a time can be checked
        if judge.late is not None:
            raise judge.late
        revocations = Revocations(home.anchor().public_key)
        revocations.update(data, now())
        revocations.confirm(stamp, now())
        await _check_master_key(revocations, stream.peer, call)
        yield f"the master at {uri} has a fresh revocation list"
        async for outcome in _check_grants(revocations, grants, call):
            yield outcome
        async for outcome in check_node_addresses(home, call):
            yield outcome
    finally:
        await stream.close()


class _Judge:
    """Verifies the master also where by this host's clock its certificate is not valid: to compare.

    Whoever answers has the key of a certificate of this authority, and by its signed timestamp the
    clock is judged; nothing else is taken from it. `late` is what the clock alone would refuse.
    """

    def __init__(self, home: NodeHome) -> None:
        self._anchors = DomainFiles(home, home.anchor()).anchors()
        self._own = svid.validity(svid.parse(home.credentials().chain[0]))
        self.late: HintedError | None = None

    def verify(self, chain: tuple[bytes, ...], at: int) -> Identity:
        """As the anchors do; out of its time, as of the time of this node's own certificate."""
        try:
            return self._anchors.verify(chain, at)
        except (CertificateExpired, CertificateNotYetValid) as error:
            self.late = error.bare()
            begin, end = svid.validity(svid.parse(chain[0]))
            moment = min(max(at, begin, self._own[0]), end, self._own[1])
            return replace(self._anchors.verify(chain, moment), not_after=at + _MINUTE)


async def _connect(
    environment: Environment, home: NodeHome, uri: str, judge: _Judge
) -> SecureStream[Identity]:
    suites = post_quantum(environment.variables)
    context = SecureContext(home.credentials(), judge.verify, suites=suites)
    host, port = settings.parse_uri(uri, "the URI of the master")
    try:
        stream = await connect(host, port, context, WireProtocol.HTTP)
    except ChannelError as error:
        raise as_master(error) from error
    wanted = own_master(environment.variables)
    if stream.peer.name == wanted:
        return stream
    await stream.close()
    raise ConfigurationError(
        f"{shown(stream.peer.name)} answers there, not {wanted}",
        f"check ROS_MASTER_URI, and {OWN_MASTER} if there are several masters",
    )


def _opened(home: NodeHome, master: Identity, answer: object) -> tuple[bytes, Timestamp]:
    """The signed list, and the master's timestamp.

    Raises:
        ConfigurationError: the node is revoked, or there is no list.
        RevocationRefused: one of them is not signed as it should be.
    """
    match answer:
        case [bytes() as data, b""] if is_of_revoked(answer):
            raise ConfigurationError(f"{revoked_text(home.name)}{_where(home, data)}", anew(home))
        case [bytes() as data, bytes() as timestamp] if data:
            return data, open_timestamp(timestamp, master.public_key)
        case _:
            raise ConfigurationError(_NO_LIST, "next: rossec ca publish")


def _where(home: NodeHome, data: bytes) -> str:
    """Whether the authority's own signature shows it; a tree would need a proof."""
    statement = open_statement(data, home.anchor().public_key)
    own = home.identity(now())
    if isinstance(statement, RevocationList) and not statement.entries.isdisjoint(own.keys):
        return f", by list {statement.seq} of the authority"
    return ""


def describe_offset(issued: int, begun: float, ended: float) -> Outcome:
    """How far this host's clock is off, by a timestamp of the second in which it was signed.

    Args:
        issued: the master's time, in whole seconds, when it answered.
        begun, ended: this host's time before the question and after the answer.
    """
    behind, ahead = issued - ended, begun - (issued + 1)
    off = max(behind, ahead)
    if off <= 0:
        return "the clock agrees with the master's"
    which = "behind" if behind > 0 else "ahead of"
    text = (
        f"the clock of this host is {clock.format_duration(max(1, int(off)))} {which} the master's"
    )
    if off <= SKEW:
        return f"{text}; up to {SKEW} s are allowed"
    return ConfigurationError(
        f"{text}: nodes here take no word of the master for fresh, and refuse all connections",
        "synchronize the clocks of both hosts (NTP), then restart what runs here",
    )


async def _check_master_key(revocations: Revocations, master: Identity, call: MasterCall) -> None:
    """Raise ConfigurationError if the master itself is revoked, and still runs."""
    found = await _revoked_of(revocations, master.keys, call)
    if found:
        raise ConfigurationError(
            f"the identity of {shown(master.name)} is revoked, so that no node trusts it any more",
            "on its host: move its directory away, and enroll it anew with a new key",
        )


async def _check_grants(
    revocations: Revocations, grants: Iterable[Grant], call: MasterCall
) -> AsyncIterator[Outcome]:
    """Of grants that are in order here: whether the newest list revokes them."""
    by_entry = {entry: grant for grant in grants for entry in grant.revocable}
    for entry in await _revoked_of(revocations, tuple(by_entry), call):
        yield ConfigurationError(
            f"grant {by_entry[entry].short_id} is revoked according to the master's list",
            f"ask for another; it does no harm in {by_entry[entry].subject}'s directory",
        )


async def _revoked_of(
    revocations: Revocations, entries: Sequence[bytes], call: MasterCall
) -> list[bytes]:
    """Those that are revoked; where the list is a tree, the master is asked for proofs.

    Raises:
        RevocationsStale: of one it is not known.
    """
    for start in range(0, len(entries), MAX_PER_CALL):
        for entry in entries[start : start + MAX_PER_CALL]:
            with suppress(Revoked, RevocationsStale):
                revocations.check(entry, now())
        await prove(call, revocations)
    return [entry for entry in entries if _is_revoked(revocations, entry)]


def _is_revoked(revocations: Revocations, entry: bytes) -> bool:
    try:
        revocations.check(entry, now())
    except Revoked:
        return True
    return False
