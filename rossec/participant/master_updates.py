"""What a node takes from its master while it runs: delivered grants, and what is known of foreign domains.

The master only carries them. A grant that is not signed by the authority, for this domain and for this node's
key, or is revoked, is dropped; lists are verified here, and are on disk before they are used. A master that
knows no domains is used without them; one with an older list receives the newer one. A call that fails
otherwise is made again at the next heartbeat.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from secrets import SystemRandom
from typing import Final

from ca.bounded import Newest
from ca.certificates import Identity
from ca.errors import CAError, HintedError, RevocationsStale
from ca.names import shown
from ca.revocation.lists import digest
from ca.revocation.trust_status import TrustStatus
from grants import document
from grants.errors import GrantError, GrantExpired, GrantNotHeld
from grants.token import peek
from rossec import clock
from rossec.errors import AnswerMalformed, AnswerRefused, ConfigurationError
from rossec.home import NodeHome
from rossec.net.aio import SecureStream
from rossec.net.rpc import RpcClient
from rossec.participant.access import MembershipAccess
from rossec.participant.registrations import Retry
from rossec.participant.renewals import MAX_PROOFS_PER_CALL, MasterCall, take
from rossec.peer_limits import printable
from rossec.ros.names import DOMAINS, FOREIGN_PROOFS, FOREIGN_REVOCATIONS, MASTER, UPDATE_DOMAINS
from rossec.ros.xmlrpc import Fault, is_unknown_method
from rossec.saved_statements import DomainFiles

KEPT: Final = 30 * 86400  # seconds after its end that a file stays

FETCH: Final = "rossec.fetchGrants"
WATCH: Final = "rossec.watchGrants"
MAX_KNOWN: Final = 256  # ids in one call: the limit of the master
MAX_ANSWERS: Final = 64  # to one fetch; a master has at most 64 grants for one key
WATCH_DEADLINE: Final = 90.0  # seconds; the master answers after 60
SHORTEST: Final = 1.0  # seconds an answer without a new grant takes
CHECK_PERIOD: Final = 0.25  # seconds between looks whether the session is open
MAX_CHAIN: Final = 2  # certificates: a master's, and its intermediate's

_log = logging.getLogger("rossec.node")


class GrantDirectory:
    """Moves the grants of a directory into a node's `Access`: each once, an invalid one is logged once."""

    def __init__(self, home: NodeHome, access: MembershipAccess) -> None:
        self._home = home
        self._access = access
        self._seen: set[bytes] = set()
        self._errors: dict[Path, str] = {}

    def take_new(self) -> list[bytes]:
        paths = self._home.grant_files()
        self._errors = {path: text for path, text in self._errors.items() if path in paths}
        found = ((path, self._read(path)) for path in paths)
        return [data for path, data in found if data is not None and self._hold(path, data)]

    def hold(self, data: bytes) -> bool:
        return self._hold(self._home.path, data)

    def save(self, grant_id: bytes, data: bytes) -> None:
        try:
            self._home.add_grant(grant_id, data)
        except (OSError, HintedError) as error:  # the master has it after a restart, too
            _log.warning("a delivered grant is used, but not saved: %s", error)

    def drop_ended(self, now: int) -> None:
        """Delete the files of grants that ended long ago; only while the master confirms `now`."""
        for path in self._home.grant_files():
            data = self._read(path)
            with contextlib.suppress(GrantError, OSError):
                grant = None if data is None else peek(data)
                if grant is not None and path == self._home.grant_file(grant.id) and now >= grant.cap + KEPT:
                    path.unlink()

    def _read(self, path: Path) -> bytes | None:
        try:
            data = self._home.read_grant(path)
        except (OSError, HintedError) as error:
            text = f"cannot be read: {error}"
            if self._errors.get(path) != text:
                self._errors[path] = text
                _log.warning("%s %s", path, text)
            return None
        self._errors.pop(path, None)
        return data

    def _hold(self, path: Path, data: bytes) -> bool:
        if data in self._seen:
            return False
        self._seen.add(data)
        try:
            self._access.hold(data)
        except HintedError as error:
            _log.warning("%s is not a valid grant and is ignored: %s", path, error)
            return False
        return True


class GrantDelivery:
    """Takes what the master has for one node: grants that the authority deposited there.

    They are fetched in each session, and while it lasts a call of its own connection waits for more.
    `holder`: the thumbprint of the node's key.
    """

    def __init__(
        self, trust_status: TrustStatus, holder: bytes, access: MembershipAccess, directory: GrantDirectory
    ) -> None:
        self._trust_status = trust_status
        self._holder = holder
        self._access = access
        self._directory = directory
        self._received: Newest[bytes, None] = Newest(MAX_KNOWN)  # ids, also of invalid ones
        self._new: list[bytes] = []
        self._unsaved: list[tuple[bytes, bytes]] = []
        self._arrived = asyncio.Event()
        self.supported = asyncio.Event()  # set while the master of the session knows the calls
        self.taken = 0  # grants that were new so far

    async def fetch(self, call: MasterCall) -> None:
        """Fetch everything, at the beginning of a session; what was refused is judged again. A master that
        forged a grant, or a clock that was wrong, keeps it away no longer than that."""
        self._received.clear()
        try:
            for _ in range(MAX_ANSWERS):
                if not self.take(await call(FETCH, self.known())):
                    break
        except (Fault, AnswerRefused):
            self.supported.clear()
        else:
            self.supported.set()

    def known(self) -> bytes:
        # Ids, and no number that the master counts: nothing is lost by a restart of either side (0027).
        ids = dict.fromkeys(reversed(self._received))
        ids |= dict.fromkeys(held.grant.id for held in self._access.held_grants())
        return b"".join(list(ids)[:MAX_KNOWN])

    def take(self, answer: object) -> bool:
        """Hold the valid grants of an answer; returns whether more follow."""
        match answer:
            case {"grants": list() as grants, "more": bool() as more} if not more or grants:
                for data in grants:
                    self._take(data)
                return more
            case _:
                raise AnswerMalformed("the master's answer is not a list of grants")

    def take_new(self) -> list[bytes]:
        """The grants that are new since the last call; they are held."""
        new, self._new = self._new, []
        self._arrived.clear()
        return new

    async def save(self) -> None:
        """Store what was taken: after it is in use, and in a thread, since a disk may be slow."""
        unsaved, self._unsaved = self._unsaved, []
        for grant_id, data in unsaved:
            await asyncio.to_thread(self._directory.save, grant_id, data)

    async def wait(self, longest: float) -> None:
        """Return when a grant is new, or after `longest` seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await self._arrived.wait()

    def _take(self, data: object) -> None:
        if not isinstance(data, bytes):
            raise AnswerMalformed("the master sends a grant that is not bytes")
        try:
            grant_id = document.grant_id(data)
            self._received[grant_id] = None
            self._check(data, clock.now())
        except HintedError as error:
            _log.warning("a grant that the master delivers is refused: %s", printable(error))
            return
        if self._directory.hold(data):
            self._new.append(data)
            self._unsaved.append((grant_id, data))
            self.taken += 1
            self._arrived.set()

    def _check(self, data: bytes, now: int) -> None:
        # Verify a grant; one that is not valid yet, or may be renewed, is taken too.
        domain = document.peek(data).domain
        # Whose key it must be signed by: the domain that it names only selects one of those trusted here.
        listed = self._trust_status.anchors.listed_domain(domain)
        anchor = self._trust_status.anchors.own if listed is None else listed.anchor
        grant = document.verify(data, anchor.public_key, domain=anchor.domain)
        if grant.holder != self._holder:
            raise GrantNotHeld("the grant is bound to another key", f"it is for {grant.subject}")
        if now >= grant.cap:
            raise GrantExpired(f"the grant {grant.short_id} has expired")
        if grant.id in self._trust_status.own.entries | self._trust_status.revoked(grant.domain):
            raise GrantError(f"the grant {grant.short_id} is revoked")


@dataclass(eq=False)
class GrantWatch:
    """Waits at the master for grants, on a connection of its own, while the session is open."""

    _name: str
    _delivery: GrantDelivery
    _dial: Callable[[], Awaitable[SecureStream[Identity]]]
    _is_open: Callable[[], bool]
    _master: str = MASTER
    _client: RpcClient | None = field(default=None, init=False)

    async def session_opened(self) -> None:
        await self._disconnect()

    async def run(self) -> None:
        retry = Retry(SystemRandom().random)
        try:
            while True:
                await self._delivery.supported.wait()
                if not self._is_open():
                    await asyncio.sleep(CHECK_PERIOD)
                    continue
                try:
                    await self._watch(retry)
                except (HintedError, OSError, TimeoutError, Fault) as error:
                    _log.debug("%s: waits for grants again: %s", self._name, printable(error))
                    await self._disconnect()
                    await asyncio.sleep(retry.pause(asyncio.get_running_loop().time()))
        finally:
            await self._disconnect()

    async def _watch(self, retry: Retry) -> None:
        # A connection of its own: a session has one call at a time, and this one waits for a minute (0027).
        stream = await self._dial()
        if stream.peer.name != self._master:
            stream.abort("not the master")
            raise ConfigurationError(f"{shown(stream.peer.name)} answers at the master's address")
        client = self._client = RpcClient(stream, deadline=WATCH_DEADLINE)
        while True:
            began, before = asyncio.get_running_loop().time(), self._delivery.taken
            self._delivery.take(await client.ask(WATCH, self._name, self._delivery.known()))
            retry.succeeded()
            took = asyncio.get_running_loop().time() - began
            if self._delivery.taken == before and took < SHORTEST:
                await asyncio.sleep(SHORTEST)  # nothing new, and yet at once

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(HintedError, OSError):
                await client.close()


@dataclass(eq=False)
class DomainUpdates:
    """Takes lists of domains, and revocations of foreign ones.

    The list is fetched at each beginning of a session and with each heartbeat, the revocations of a foreign
    domain when its peers or grants are here, and of the others often enough that a new peer finds them fresh;
    both are pushed besides. `changed` is called after each that was taken, to cut what it ends: with whether
    it says anything new, so that what was refused may be tried again. `lock` is held while `trust_status` is
    changed, if threads share it.
    """

    _trust_status: TrustStatus
    _files: DomainFiles
    _changed: Callable[[bool], None]
    _in_use: Callable[[], Iterable[str]]  # the foreign domains of which there are peers or grants here
    _lock: AbstractContextManager[object] = field(default_factory=nullcontext)
    _supported: bool = field(default=True, init=False)
    _wanted: set[str] = field(default_factory=set, init=False)  # domains whose revocations are fetched next
    _warned: dict[str, str] = field(default_factory=dict, init=False)

    # -- what the master pushes, or answers

    def take_domains(self, data: bytes) -> bool:
        anchors = self._trust_status.anchors
        with self._lock:
            if data == anchors.data:
                return False
            anchors.update(data, self._files.save_domains)
            # A domain that is new here begins with the newest list that was ever seen of it.
            self._files.restore(self._trust_status, clock.now())
            self._wanted = {each.entry.domain for each in anchors.all_listed}
        self._changed(True)
        return True

    def take_foreign(
        self, domain: str, revocations: bytes, timestamp: bytes, chain: Sequence[object]
    ) -> None:
        certificates = [item for item in chain if isinstance(item, bytes)]
        if len(certificates) != len(chain) or len(chain) > MAX_CHAIN:
            raise AnswerMalformed("the chain of a foreign master is not a list of certificates")
        listed = self._trust_status.anchors.listed_domain(domain)
        persist = None if listed is None else partial(self._files.save_foreign, listed.anchor)
        now, before = clock.now(), self._state(domain)
        try:
            with self._lock:
                self._trust_status.take_foreign(domain, revocations, timestamp, certificates, now, persist)
        finally:
            self._changed(self._state(domain) != before)

    # -- calls to the master

    async def session_opened(self, call: MasterCall) -> None:
        self._supported = True
        self._wanted = {each.entry.domain for each in self._trust_status.anchors.all_listed}
        if await self._fetch_domains(call) and self._trust_status.anchors.data:
            with contextlib.suppress(Fault, AnswerRefused):
                if await call(DOMAINS, digest(b"")) == b"":  # it has none at all
                    await self._send(call)
        await self.fetch_wanted(call)

    async def heartbeat(self, call: MasterCall) -> None:
        await self._fetch_domains(call)
        self._wanted |= self._due(clock.now())
        await self.fetch_wanted(call)

    async def fetch_wanted(self, call: MasterCall) -> None:
        # Those of which there is no list yet are asked for each time: until then every peer of the domain is
        # refused, and the master may receive its first list a moment after this node asked.
        self._wanted |= {
            each.entry.domain
            for each in self._trust_status.anchors.all_listed
            if (held := self._trust_status.foreign(each.entry.domain)) is None or held.current is None
        }
        while self._wanted and self._supported:
            await self._fetch_foreign(call, self._wanted.pop())
        for listed in self._trust_status.anchors.all_listed:
            if self._supported and await self._prove(call, listed.entry.domain):
                await self._fetch_foreign(call, listed.entry.domain)

    async def _fetch_domains(self, call: MasterCall) -> bool:
        if not self._supported:
            return False
        try:
            answer = await call(DOMAINS, digest(self._trust_status.anchors.data))
        except (Fault, AnswerRefused) as error:
            if is_unknown_method(error):
                _log.debug("the master knows no domains: %s", printable(error))
                self._supported = False
            else:
                self._warn(DOMAINS, error)
            return False
        if not isinstance(answer, bytes):
            self._warn(DOMAINS, AnswerMalformed("the master's list of domains is not one"))
            return False
        if not answer:
            self._warned.pop(DOMAINS, None)
            return True
        try:
            self.take_domains(answer)
        except CAError as error:
            self._warn(DOMAINS, error)
            await self._send(call)
        return False

    async def _send(self, call: MasterCall) -> None:
        held = self._trust_status.anchors.data
        try:
            newer = bool(held) and await call(UPDATE_DOMAINS, held) == 1
        except (Fault, AnswerRefused) as error:
            self._warn(UPDATE_DOMAINS, error)
            return
        if newer:
            _log.warning(
                "the master had an older list of domains than this node, and has received the"
                " newer one: was its home restored from a backup?"
            )

    async def _fetch_foreign(self, call: MasterCall, domain: str) -> None:
        held = self._trust_status.foreign(domain)
        if held is None:
            return
        try:
            match await call(FOREIGN_REVOCATIONS, domain, digest(held.data)):
                case [bytes() as revocations, bytes() as timestamp, list() as chain]:
                    self.take_foreign(domain, revocations, timestamp, chain)
                case _:
                    raise AnswerMalformed("the master's answer is not a foreign revocation list")
            self._warned.pop(domain, None)
        except (Fault, AnswerRefused, AnswerMalformed, CAError) as error:
            self._warn(domain, error)

    async def _prove(self, call: MasterCall, domain: str) -> bool:
        held = self._trust_status.foreign(domain)
        wanted = [] if held is None else held.unproved[:MAX_PROOFS_PER_CALL]
        if held is None or not wanted:
            return False
        try:
            answer = await call(FOREIGN_PROOFS, domain, wanted)
            if isinstance(answer, list) and len(answer) == len(wanted):
                # Without the proofs that the master does not have yet: it fetches them, and is asked again.
                known = [pair for pair in zip(wanted, answer, strict=True) if pair[1] != b""]
                wanted, answer = [entry for entry, _ in known], [proof for _, proof in known]
            with self._lock:
                taken = take(held.add_proof, wanted, answer)
        except (Fault, AnswerRefused, AnswerMalformed) as error:
            self._warn(f"{domain}: proofs", error)
            return False
        self._changed(taken > 0)
        return taken > 0

    def _state(self, domain: str) -> tuple[bytes, bool]:
        with self._lock:
            held = self._trust_status.foreign(domain)
            return (b"", False) if held is None else (held.data, held.fresh_until >= clock.now())

    def _due(self, now: int) -> set[str]:
        listed = {each.entry.domain: each.entry for each in self._trust_status.anchors.all_listed}
        due = listed.keys() & set(self._in_use())
        for domain, entry in listed.items():
            held = self._trust_status.foreign(domain)
            if held is None or held.fresh_until - now < entry.fresh // 2:
                due.add(domain)
        return due

    def _warn(self, what: str, error: Exception) -> None:
        text = printable(error)
        if self._warned.get(what) == text:
            return
        self._warned[what] = text
        level = logging.INFO if isinstance(error, RevocationsStale) else logging.WARNING
        _log.log(level, "%s: %s", what, text)
