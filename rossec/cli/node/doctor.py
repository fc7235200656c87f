"""`rossec doctor`: check whether a node is set up correctly, and what of it is unprotected.

Each check is one line, `ok` or `not ok` with what to do; the command fails when one is not ok. What
is revoked is not ok, wherever on this machine that is known, without a running master. Plain
connections that are allowed get a line of their own and are no failure: they were configured.
What is learned from the master comes over a connection on which it proved its identity, and is signed;
of an unauthenticated host not even the time is taken.
"""

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Final

import click

from ca import errors as refusals
from ca import svid
from ca.certificates import Identity, TrustAnchor, signed_at
from ca.names import display_name, is_master_name, is_relay_name, shown
from ca.revocation.lists import RevocationList, Timestamp, TreeEntries, open_timestamp
from ca.revocation.trust_status import SKEW, Revocations, open_statement
from grants.errors import GrantRevoked
from grants.model import Grant
from grants.request import in_shell
from rossec import clock, files
from rossec.authority.home import AuthorityHome
from rossec.channel.opening import post_quantum
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import REVOCATIONS, anew, find_master, is_of_revoked, open_held, revoked_text
from rossec.environment import OWN_MASTER, missing_nodes, nodes_in, own_master
from rossec.errors import ChannelError, ConfigurationError
from rossec.home import NodeHome
from rossec.host import addresses
from rossec.inprocess import file_of, read
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, as_master, connect
from rossec.net.rpc import RpcClient
from rossec.participant.renewals import MAX_PROOFS_PER_CALL, MasterCall, prove
from rossec.peer_limits import printable
from rossec.ros import names
from rossec.ros.names import MASTER, PRESENT_GRANTS
from rossec.saved_statements import DomainFiles
from rossec.terminal import printable as terminal_printable
from rossec.terminal import say, say_json, state

Outcome = str | refusals.HintedError
"""A line that is ok, or a fault that does not end the check."""
LIMIT: Final = 64  # nodes whose address is looked up
_MAX_FILE = 64 * 1024
Check = Callable[[Environment, NodeHome], Iterator[Outcome]]


@click.command()
@click.argument("names", metavar="[NODE]...", nargs=-1)
@options.flag("--offline", "do not ask the master")
@options.as_json
@pass_environment
def doctor(environment: Environment, names: tuple[str, ...], offline: bool, as_json: bool) -> None:
    """Check the set-up of NODE on this machine: identity, grants, master, what is plain.

    Without NODE every node of this machine; what several have in common is said once.
    """
    homes, unfinished = [NodeHome.find(environment.home, name) for name in names], list[str]()
    if not homes:
        homes, unfinished = _all(environment)
    checks = _CHECKS if offline else {**_CHECKS, "master": _master}
    findings = [finding for home in homes for finding in _examine(environment, home, checks)]
    plain = list(_plain(environment))
    if as_json:
        say_json(
            {"findings": [asdict(finding) for finding in findings], "plain": plain, "unfinished": unfinished}
        )
    else:
        _say(findings, plain, several=len(homes) > 1)
        for name in unfinished:
            say(f"-       {shown(name)} is not enrolled yet: rossec node join again, or remove")
            say(f"        {terminal_printable(str(NodeHome.of(environment.home, name).path))}")
    failed = {(finding.node, finding.check) for finding in findings if not finding.ok}
    if failed:
        said = {(finding.text, finding.hint) for finding in findings if not finding.ok}
        of = f"{len(failed)} of {len(homes) * len(checks)} checks"
        causes = "for one cause" if len(said) == 1 else f"for {len(said)} causes"
        raise ConfigurationError(f"{of} failed" + f", {causes}" * (len(said) < len(failed)), "see above")


def _all(environment: Environment) -> tuple[list[NodeHome], list[str]]:
    # Where none has an identity, that is what has to be said of each.
    found = [NodeHome.of(environment.home, name) for name in nodes_in(environment.home)]
    if not found:
        raise ConfigurationError(
            f"there is no node in {environment.home / 'nodes'}", missing_nodes(environment.home)
        )
    enrolled = [home for home in found if (home.path / "node.pem").exists()]
    if not enrolled:
        return found, []
    return enrolled, [home.name for home in found if home not in enrolled]


@dataclass(frozen=True)
class DoctorFinding:
    node: str
    check: str
    ok: bool
    text: str
    hint: str = ""


def _examine(
    environment: Environment, home: NodeHome, checks: Mapping[str, Check]
) -> Iterator[DoctorFinding]:
    for name, check in checks.items():
        try:
            for found in check(environment, home):
                hint = "" if isinstance(found, str) else found.hint
                yield DoctorFinding(home.name, name, isinstance(found, str), str(found), hint)
        except refusals.HintedError as error:
            yield DoctorFinding(home.name, name, False, str(error), error.hint)
            if isinstance(error, IdentityRevoked):
                return  # nobody talks to it: whatever else would be said has this cause


def _identity(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    identity = home.identity(now())
    known = known_revocations(environment.home, home)
    if revoked := [key for key in identity.keys if key in known]:
        which = "" if revoked[0] == identity.thumbprint else "intermediate's "
        raise IdentityRevoked(
            f"the {which}key of {identity.name} is revoked according to {known[revoked[0]]}", anew(home)
        )
    yield f"{identity.name} of {identity.domain} until {clock.format_time(identity.not_after)}"
    yield from _clock(home, identity)
    life = identity.not_after - signed_at(identity.not_before, identity.not_after)
    # of an identity's life: by then it should have been renewed
    if identity.not_after - now() < life / 3:
        left = clock.format_duration(identity.not_after - now())
        raise ConfigurationError(
            f"the identity ends soon, in {left}, and was not renewed",
            f"it is while {home.name} runs, if where the authority is `rossec ca serve` runs and is"
            f" unlocked (rossec ca status); or there: rossec ca renew {home.name}, then here:"
            " rossec node install FILE",
        )


def known_revocations(home: Path, node: NodeHome) -> dict[bytes, str]:
    """Each entry that is revoked, with the source that lists it: of several, every entry counts."""
    anchor, found = node.anchor(), dict[bytes, str]()
    for place in (node, NodeHome.of(home, MASTER)):
        for entry in _listed(place, anchor):
            found.setdefault(entry, f"the list in {place.path}")
    with suppress(refusals.HintedError):
        authority = AuthorityHome.at(home)
        # An intermediate below the node's authority records only what it signed itself.
        if authority.anchor().thumbprint == anchor.thumbprint and not authority.is_intermediate:
            with closing(authority.store()) as store:
                found |= dict.fromkeys(store.revoked_entries(), f"the authority's record in {home / 'ca'}")
    return found


def _listed(place: NodeHome, anchor: TrustAnchor) -> Iterator[bytes]:
    # What a list that was saved holds; a tree's entries are only in a master's home.
    data = place.load_revocations()
    if data is None:
        return
    with suppress(refusals.RevocationRefused):  # a list of another authority does not concern this node
        statement = open_statement(data, anchor.public_key)
        if isinstance(statement, RevocationList):
            yield from statement.entries
        elif (entries := place.load_entries()) is not None:
            listing = TreeEntries.read(entries)
            listing.check(statement)
            yield from listing.entries


class IdentityRevoked(ConfigurationError):
    pass


def _clock(home: NodeHome, identity: Identity) -> Iterator[Outcome]:
    signed = signed_at(identity.not_before, identity.not_after)
    # What the authority has signed is a lower bound of the time, also without a master (decision 0044).
    if (data := home.load_revocations()) is not None:
        with suppress(refusals.RevocationRefused):  # a list of another authority says nothing
            signed = max(signed, open_statement(data, home.anchor().public_key).issued)
    if now() < signed - SKEW:
        yield ConfigurationError(
            f"the clock of this host is {clock.format_duration(signed - now())} or more behind:"
            f" the authority has signed what is here at {clock.format_time(signed)}",
            "set the clock of this host, or synchronize it (NTP)",
        )


def check_own_address(variables: Mapping[str, str]) -> Iterator[Outcome]:
    address = names.own_address(variables)
    if address is None:
        return
    yield addresses.check_own_address(address, addresses.variable_of(variables))


def _grants(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    held, (usable, refused) = home.grants(), _open_grants(environment, home)
    for grant in usable:
        label = _label(home, grant)
        for permission in grant.links[-1].permissions:
            until = clock.format_time(grant.expires)
            pattern = display_name(label, permission.pattern)
            yield f"may {permission.rights.label} {pattern} until {until}"
    if not held and is_relay_name(home.name):
        yield "no grants: a relay needs none"
    elif not held and is_master_name(home.name):
        yield "no grants: within its own domain a master needs none"
    elif not held:
        own = in_shell("{node}/**" if home.identity(now()).wildcard else f"{home.name}/**")
        raise ConfigurationError(
            "no grants: it may do nothing",
            f"at the authority, for example its own topics: rossec grant sign {home.name} --publish"
            f" {own}; a program says what it lacks when it is refused",
        )
    for errors in refused.values():
        others = f" (and {len(errors) - 1} more)" if errors[1:] else ""
        yield ConfigurationError(f"{errors[0]}{others}", errors[0].hint)


def _open_grants(
    environment: Environment, home: NodeHome
) -> tuple[list[Grant], dict[type[refusals.HintedError], list[refusals.HintedError]]]:
    revoked = known_revocations(environment.home, home)
    refused = defaultdict[type[refusals.HintedError], list[refusals.HintedError]](list)
    usable = []
    for data in home.grants():
        try:
            grant = open_held(home, data, now())
            for entry in (*grant.revocable, grant.holder):
                if entry in revoked:
                    raise GrantRevoked(
                        f"grant {grant.short_id} is revoked according to {revoked[entry]}",
                        f"ask for another; it does no harm in {grant.subject}'s directory",
                    )
        except refusals.HintedError as error:
            refused[type(error)].append(error)
        else:
            usable.append(grant)
    return usable, refused


def _label(home: NodeHome, grant: Grant) -> str:
    anchor = home.anchor()
    listed = DomainFiles(home, anchor).anchors().listed_domain(grant.domain)
    if listed is not None:
        return listed.entry.label
    return "" if grant.domain == anchor.domain else grant.domain


def check_domains(home: Path, node: NodeHome, now: int) -> Iterator[str]:
    anchor = node.anchor()
    held, newest = DomainFiles(node, anchor).anchors().current, None
    with suppress(refusals.HintedError):
        authority = AuthorityHome.at(home)
        if authority.anchor().thumbprint == anchor.thumbprint and (listed := authority.domain_list()):
            newest = listed[1]
    for each in () if held is None else held.domains:
        ended = "" if now < each.until else ", which is over"
        until = clock.format_time(each.until)
        yield f"admits nodes of {each.domain}, here {each.label}, until {until}{ended}"
    if held is not None and now >= held.expires:
        raise ConfigurationError(
            "the list of domains has expired: no foreign node is admitted",
            "at the authority: rossec ca refresh",
        )
    if newest is not None and (held is None or held.number < newest.number):
        raise ConfigurationError(
            "the node has not the newest list of domains",
            "deliver it: rossec ca publish; the node takes it from the master while it runs",
        )


_CHECKS: Final[dict[str, Check]] = {
    "identity": _identity,
    "address": lambda environment, _: check_own_address(environment.variables),
    "grants": _grants,
    "domains": lambda environment, home: check_domains(environment.home, home, now()),
}


def _master(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    if home.name == own_master(environment.variables):  # it would meet its own certificate
        yield "the master of this host: rossec master status"
        return

    async def ask() -> list[Outcome]:
        found = list[Outcome]()
        try:
            usable, _ = _open_grants(environment, home)
            async for outcome in check_master(environment, home, usable):
                found.append(outcome)
        except refusals.HintedError as error:
            found.append(error)
        return found

    yield from asyncio.run(ask())


async def check_master(
    environment: Environment, home: NodeHome, grants: Iterable[Grant]
) -> AsyncIterator[Outcome]:
    uri = await find_master(environment, home)
    judge = _Judge(home)
    stream = await _connect(environment, home, uri, judge)
    try:
        client = RpcClient(stream)

        async def call(method: str, *parameters: object) -> object:
            return await client.ask(method, home.name, *parameters)

        # The answer bounds the offset by the times before and after it: a slow network makes no clock wrong.
        begun = clock.time()
        data, stamp = _opened(home, stream.peer, await call(REVOCATIONS))
        yield (said := describe_offset(stamp.issued, begun, clock.time()))
        if isinstance(said, refusals.HintedError):
            return  # nothing that has a time can be checked
        if judge.late is not None:
            raise judge.late
        revocations = Revocations(home.anchor().public_key)
        revocations.update(data, now())
        revocations.confirm(stamp, now())
        if await _revoked_of(revocations, stream.peer.keys, call):
            raise ConfigurationError(
                f"the identity of {shown(stream.peer.name)} is revoked, so that no node trusts it any more",
                "on its host: move its directory away, and enroll it anew with a new key",
            )
        yield f"the master at {uri} has a fresh revocation list"
        by_entry = {entry: grant for grant in grants for entry in grant.revocable}
        for entry in await _revoked_of(revocations, tuple(by_entry), call):
            yield ConfigurationError(
                f"grant {by_entry[entry].short_id} is revoked according to the master's list",
                f"ask for another; it does no harm in {by_entry[entry].subject}'s directory",
            )
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
        self.late: refusals.HintedError | None = None

    def verify(self, chain: tuple[bytes, ...], at: int) -> Identity:
        try:
            return self._anchors.verify(chain, at)
        except (refusals.CertificateExpired, refusals.CertificateNotYetValid) as error:
            self.late = error.bare()
            begin, end = svid.validity(svid.parse(chain[0]))
            moment = min(max(at, begin, self._own[0]), end, self._own[1])
            # seconds that a connection may last whose certificate is out of its time
            return replace(self._anchors.verify(chain, moment), not_after=at + 60)


async def _connect(
    environment: Environment, home: NodeHome, uri: str, judge: _Judge
) -> SecureStream[Identity]:
    suites = post_quantum(environment.variables)
    context = SecureContext(home.credentials(), judge.verify, suites=suites)
    host, port = names.parse_uri(uri, "the URI of the master")
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
    match answer:
        case [bytes() as data, b""] if is_of_revoked(answer):
            raise ConfigurationError(f"{revoked_text(home.name)}{_where(home, data)}", anew(home))
        case [bytes() as data, bytes() as timestamp] if data:
            return data, open_timestamp(timestamp, master.public_key)
        case _:
            raise ConfigurationError("the master has no revocation list", "next: rossec ca publish")


def _where(home: NodeHome, data: bytes) -> str:
    # Whether the authority's own signature shows it; a tree would need a proof.
    statement = open_statement(data, home.anchor().public_key)
    own = home.identity(now())
    if isinstance(statement, RevocationList) and not statement.entries.isdisjoint(own.keys):
        return f", by list {statement.seq} of the authority"
    return ""


def describe_offset(issued: int, begun: float, ended: float) -> Outcome:
    """How far this host's clock is off, by a timestamp of the second in which it was signed.

    `issued` is the master's time, in whole seconds, when it answered; `begun` and `ended` are this
    host's before the question and after the answer.
    """
    behind, ahead = issued - ended, begun - (issued + 1)
    off = max(behind, ahead)
    if off <= 0:
        return "the clock agrees with the master's"
    which = "behind" if behind > 0 else "ahead of"
    text = f"the clock of this host is {clock.format_duration(max(1, int(off)))} {which} the master's"
    if off <= SKEW:
        return f"{text}; up to {SKEW} s are allowed"
    return ConfigurationError(
        f"{text}: nodes here take no word of the master for fresh, and refuse all connections",
        "synchronize the clocks of both hosts (NTP), then restart what runs here",
    )


async def _revoked_of(revocations: Revocations, entries: Sequence[bytes], call: MasterCall) -> list[bytes]:
    # As many as the master answers in one call.
    for start in range(0, len(entries), MAX_PROOFS_PER_CALL):
        for entry in entries[start : start + MAX_PROOFS_PER_CALL]:
            with suppress(refusals.Revoked, refusals.RevocationsStale):
                revocations.check(entry, now())
        await prove(call, revocations)
    return [entry for entry in entries if _is_revoked(revocations, entry)]


def _is_revoked(revocations: Revocations, entry: bytes) -> bool:
    try:
        revocations.check(entry, now())
    except refusals.Revoked:
        return True
    return False


async def check_node_addresses(home: NodeHome, call: MasterCall) -> AsyncIterator[Outcome]:
    await call(PRESENT_GRANTS, home.grants())
    for name in islice(_nodes(await call("getSystemState")), LIMIT):
        with suppress(ConfigurationError):  # a service without a slave API
            host, _ = names.parse_uri(str(await call("lookupNode", name)))
            if not await asyncio.to_thread(addresses.resolved, host):
                yield ConfigurationError(
                    f"{shown(name)} is at {printable(host)}, a name that this host does not know",
                    "enter the name in /etc/hosts here, or set ROS_IP on its host and start it again",
                )


def _nodes(state: object) -> list[str]:
    match state:
        case [list() as publishers, _, list() as services]:
            entries = [*publishers, *services]
            nodes = [node for entry in entries for node in (entry[1] if len(entry) == 2 else ())]
            return list(dict.fromkeys(map(str, nodes)))
        case _:
            return []


def _plain(environment: Environment) -> tuple[str, ...]:
    path = file_of(environment.variables)
    missing = ConfigurationError(f"{path} cannot be read")
    text = None
    if path.exists():  # as `rossec.secure` reads it
        text = files.read(path, _MAX_FILE, missing).decode(errors="replace")
    return read(environment.variables, text).allow_plain


def _say(findings: list[DoctorFinding], plain: list[str], *, several: bool) -> None:
    causes: dict[tuple[bool, str, str], list[str]] = {}
    for finding in findings:
        causes.setdefault((finding.ok, finding.text, finding.hint), []).append(finding.node)
    for (ok, text, hint), nodes in causes.items():
        who = f"{', '.join(map(shown, dict.fromkeys(nodes)))}: " if several else ""
        say(f"{state('ok    ' if ok else 'not ok')}  {terminal_printable(who + text)}")
        if not ok:
            say(f"        {terminal_printable(hint)}")
    for entry in plain:
        say(f"PLAIN   {terminal_printable(entry)} is neither encrypted nor checked: allow_plain names it")
