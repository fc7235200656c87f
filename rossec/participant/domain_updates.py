"""What a node knows of foreign domains, kept current at its master.

The list of domains is fetched at each beginning of a session and with each heartbeat, the
revocations of a foreign domain when its peers or grants are here, and of the others often enough
that a new peer finds them fresh; both are pushed besides. The master only carries them: everything
is verified here, and is on disk before it is used. A master that knows no domains, of an older
version, is used without them; one with an older list receives the newer one. A call that fails
otherwise is made again at the next heartbeat.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Final

from ca.domains.standing import Standing
from ca.errors import CAError, RevocationsStale
from ca.revocation.state import digest
from rossec import clock
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.participant.grant_renewal import MasterCall
from rossec.participant.revocation_proofs import MAX_PER_CALL, take
from rossec.ros.names import DOMAINS, FOREIGN_PROOFS, FOREIGN_REVOCATIONS, UPDATE_DOMAINS
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault, is_unknown_method
from rossec.saved_domains import DomainFiles

MAX_CHAIN: Final = 2  # certificates: a master's, and its intermediate's

_log = logging.getLogger("rossec.node")


class DomainUpdates:
    """Takes lists of domains, and revocations of foreign ones.

    Args:
        standing: what they change; `lock` is held meanwhile, if threads share it.
        files: where they are saved.
        changed: called after each that was taken, to cut what it ends; whether it says anything
            new, so that what was refused may be tried again.
        in_use: the foreign domains of which there are peers or grants here.
    """

    def __init__(
        self,
        standing: Standing,
        files: DomainFiles,
        changed: Callable[[bool], None],
        in_use: Callable[[], Iterable[str]],
        lock: AbstractContextManager[object] = nullcontext(),  # noqa: B008 - has no state
    ) -> None:
        self._standing = standing
        self._files = files
        self._changed = changed
        self._in_use = in_use
        self._lock = lock
        self._supported = True
        self._wanted: set[str] = set()  # domains whose revocations are fetched next
        self._warned: dict[str, str] = {}

    # -- what the master pushes, or answers

    def take_domains(self, data: bytes) -> bool:
        """Take a list of domains; returns whether it is another one than before.

        Raises:
            DomainsRefused: it is not of the own authority, or older than one seen.
        """
        anchors = self._standing.anchors
        with self._lock:
            if data == anchors.data:
                return False
            anchors.update(data, self._files.save_domains)
            self._files.restore(self._standing, clock.now())
            self._wanted = {each.entry.domain for each in anchors.all_listed}
        self._changed(True)
        return True

    def take_foreign(
        self, domain: str, revocations: bytes, timestamp: bytes, chain: Sequence[object]
    ) -> None:
        """Take a foreign domain's list (empty: the one held) and its master's timestamp.

        Raises:
            CAError: either is refused; see `Standing.take_foreign`. What a valid list revokes is
                cut nevertheless.
        """
        certificates = [item for item in chain if isinstance(item, bytes)]
        if len(certificates) != len(chain) or len(chain) > MAX_CHAIN:
            raise AnswerMalformed("the chain of a foreign master is not a list of certificates")
        listed = self._standing.anchors.listed_domain(domain)
        persist = None if listed is None else partial(self._files.save_foreign, listed.anchor)
        now, before = clock.now(), self._state(domain)
        try:
            with self._lock:
                self._standing.take_foreign(
                    domain, revocations, timestamp, certificates, now, persist
                )
        finally:
            self._changed(self._state(domain) != before)

    # -- calls to the master

    async def session_opened(self, call: MasterCall) -> None:
        """Fetch everything: the master may be another one, or have been restored from a backup.

        Raises:
            RossecError: the master is out of reach.
        """
        self._supported = True
        self._wanted = {each.entry.domain for each in self._standing.anchors.all_listed}
        if await self._fetch_domains(call) and self._standing.anchors.data:
            await self._send_missing(call)
        await self.fetch_wanted(call)

    async def heartbeat(self, call: MasterCall) -> None:
        """Fetch the list of domains, and the revocations that are due; raises likewise."""
        await self._fetch_domains(call)
        self._wanted |= self._due(clock.now())
        await self.fetch_wanted(call)

    async def fetch_wanted(self, call: MasterCall) -> None:
        """Fetch the revocations of domains that are new, and proofs; raises likewise.

        Those of which there is no list yet are asked for each time: until then every peer of the
        domain is refused, and the master may receive its first list a moment after this node asked.
        """
        self._wanted |= {
            each.entry.domain
            for each in self._standing.anchors.all_listed
            if (held := self._standing.foreign(each.entry.domain)) is None or held.current is None
        }
        while self._wanted and self._supported:
            await self._fetch_foreign(call, self._wanted.pop())
        for listed in self._standing.anchors.all_listed:
            if self._supported and await self._prove(call, listed.entry.domain):
                await self._fetch_foreign(call, listed.entry.domain)

    async def _fetch_domains(self, call: MasterCall) -> bool:
        """Whether the master gave no newer list: it has the same one, or none."""
        if not self._supported:
            return False
        try:
            answer = await call(DOMAINS, digest(self._standing.anchors.data))
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
        if answer:
            return await self._take_or_send(call, answer)
        self._warned.pop(DOMAINS, None)
        return True

    async def _take_or_send(self, call: MasterCall, data: bytes) -> bool:
        """Take the master's list; one that is older is answered by the newer one."""
        try:
            self.take_domains(data)
        except CAError as error:
            self._warn(DOMAINS, error)
            await self._send(call)
        return False

    async def _send_missing(self, call: MasterCall) -> None:
        """Send the list to a master that has none."""
        try:
            answer = await call(DOMAINS, digest(b""))
        except (Fault, AnswerRefused):
            return
        if answer == b"":
            await self._send(call)

    async def _send(self, call: MasterCall) -> None:
        held = self._standing.anchors.data
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
        held = self._standing.foreign(domain)
        if held is None:
            return
        try:
            answer = await call(FOREIGN_REVOCATIONS, domain, digest(held.data))
            self.take_foreign(domain, *_foreign(answer))
            self._warned.pop(domain, None)
        except (Fault, AnswerRefused, AnswerMalformed, CAError) as error:
            self._warn(domain, error)

    async def _prove(self, call: MasterCall, domain: str) -> bool:
        """Request the proofs that a foreign tree waits for; returns whether any was accepted."""
        held = self._standing.foreign(domain)
        wanted = [] if held is None else held.unproved[:MAX_PER_CALL]
        if held is None or not wanted:
            return False
        try:
            asked, answer = _known(wanted, await call(FOREIGN_PROOFS, domain, wanted))
            with self._lock:
                taken = take(held, asked, answer)
        except (Fault, AnswerRefused, AnswerMalformed) as error:
            self._warn(f"{domain}: proofs", error)
            return False
        self._changed(taken > 0)
        return taken > 0

    def _state(self, domain: str) -> tuple[bytes, bool]:
        """A domain's list, and whether it is fresh."""
        with self._lock:
            held = self._standing.foreign(domain)
            return (b"", False) if held is None else (held.data, held.fresh_until >= clock.now())

    def _due(self, now: int) -> set[str]:
        """The domains that are in use, and those whose last word is half as old as it may be."""
        listed = {each.entry.domain: each.entry for each in self._standing.anchors.all_listed}
        due = listed.keys() & set(self._in_use())
        for domain, entry in listed.items():
            held = self._standing.foreign(domain)
            if held is None or held.fresh_until - now < entry.fresh // 2:
                due.add(domain)
        return due

    def _warn(self, what: str, error: Exception) -> None:
        """Log an error once for each cause; a line that is down is no news each ten seconds."""
        text = printable(error)
        if self._warned.get(what) == text:
            return
        self._warned[what] = text
        level = logging.INFO if isinstance(error, RevocationsStale) else logging.WARNING
        _log.log(level, "%s: %s", what, text)


def _known(wanted: list[bytes], answer: object) -> tuple[list[bytes], object]:
    """Without the proofs that the master does not have yet: it fetches them, and is asked again."""
    if not isinstance(answer, list) or len(answer) != len(wanted):
        return wanted, answer
    known = [pair for pair in zip(wanted, answer, strict=True) if pair[1] != b""]
    return [entry for entry, _ in known], [proof for _, proof in known]


def _foreign(answer: object) -> tuple[bytes, bytes, list[object]]:
    match answer:
        case [bytes() as revocations, bytes() as timestamp, list() as chain]:
            return revocations, timestamp, chain
        case _:
            raise AnswerMalformed("the master's answer is not a foreign revocation list")
