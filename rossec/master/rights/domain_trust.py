"""Foreign domains as the master knows them: the list of domains, and their revocations. Pure.

The master relays what other authorities say, and judges its own callers by it. A foreigner connects only
while its domain's revocations are fresh; a connection that stands ends `GRACE` seconds after they are stale.
What is known to be revoked ends at once. For grants staleness does not count here: nodes judge each other at
every connection, and the master gives no more than addresses.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.certificates import Identity
from ca.domains import NameRights
from ca.errors import NotAdmitted, RevocationRefused, RevocationsStale
from ca.keys.signing import THUMBPRINT_SIZE, thumbprint
from ca.names import is_master_name
from ca.revocation.lists import GRANT_ID_SIZE, digest, is_tree
from ca.revocation.trust_status import TrustStatus
from grants.decision import Reach, RevocationCheck
from grants.model import Permission, Right
from grants.token import Verifier
from rossec.master.rights.caller import OWN_DOMAIN

GRACE: Final = 60  # seconds that a connection stands while revocations are stale
MAX_PROOFS: Final = 16 * 1024  # of one foreign tree, and entries that wait for one
_ENTRY_SIZES: Final = (GRANT_ID_SIZE, THUMBPRINT_SIZE)  # no tree has others; they are kept here

_NOTHING: Final = Reach(())

PersistForeign = Callable[[str, bytes], None]  # Makes the revocation list of a foreign domain durable

# The newest revocation list that was saved of a foreign domain; None: there is none
LoadForeign = Callable[[str], bytes | None]


class ForeignWord(NamedTuple):
    revocations: bytes = b""
    timestamp: bytes = b""
    chain: tuple[bytes, ...] = ()

    def digest(self) -> bytes:
        return digest(self.revocations) if self.revocations else b""


class DomainTrust:
    """The list of domains, and the revocations of those that are listed."""

    def __init__(
        self,
        trust_status: TrustStatus,
        persist: Callable[[bytes], None] = lambda _data: None,
        persist_foreign: PersistForeign = lambda _domain, _data: None,
        load_foreign: LoadForeign = lambda _domain: None,
    ) -> None:
        self.trust_status: Final = trust_status
        self.anchors: Final = trust_status.anchors
        # persist, persist_foreign: make a list durable; called before it takes effect
        self._persist = persist
        self._persist_foreign = persist_foreign
        # finds a saved one when its domain is listed (again): no older one counts
        self._load_foreign = load_foreign
        self.generation = 0  # grows with every change of what is trusted or revoked elsewhere
        self.own_sites: Callable[[], Iterable[str]] = tuple  # the labels of other masters of the own domain
        self._own_masters: frozenset[bytes] = frozenset()
        self._words: dict[str, ForeignWord] = {}
        self._proofs: dict[str, dict[bytes, bytes]] = {}
        self._wanted: dict[str, dict[bytes, None]] = {}
        self._stale_since: dict[bytes, int] = {}  # by key
        self._exports: dict[str, Reach | None] = {}
        self._imports: dict[str, Reach | None] = {}  # by label
        self._list_replaced(frozenset())

    def update(self, data: bytes) -> frozenset[str] | None:
        # Those that are gone or have another root; None: it is the list held.
        before, roots = self.anchors.data, self._roots()
        ended = self.anchors.update(data, self._persist)
        if self.anchors.data == before:
            return None
        self._list_replaced(ended)
        kept = self._roots().items()
        return frozenset(domain for domain, root in roots.items() if (domain, root) not in kept)

    def take(
        self, domain: str, revocations: bytes, timestamp: bytes, chain: Sequence[bytes], now: int
    ) -> None:
        # Arguments and errors as `TrustStatus.take_foreign`. A valid list is in force even if the timestamp
        # is refused: `generation` has grown then.
        before = self._data(domain)
        persist = partial(self._persist_foreign, domain)
        try:
            self.trust_status.take_foreign(domain, revocations, timestamp, chain, now, persist)
            self._words[domain] = ForeignWord(self._data(domain), timestamp, tuple(chain))
        finally:
            if self._data(domain) != before:
                self._proofs.pop(domain, None)
                self.generation += 1

    def word(self, domain: str) -> ForeignWord:
        data, word = self._data(domain), self._words.get(domain, ForeignWord())
        return word if word.revocations == data else ForeignWord(data)

    @property
    def number(self) -> int:
        return 0 if self.anchors.current is None else self.anchors.current.seq

    def digest(self) -> bytes:
        return digest(self.anchors.data) if self.anchors.data else b""

    def proofs(self, domain: str, entries: Sequence[bytes]) -> list[bytes]:
        # The proof of each entry in a foreign tree; empty where it is not known yet. What is not known is
        # asked of that domain's master (`wanted_proofs`): ask again.
        if not is_tree(self._data(domain)):
            return []
        known, wanted = self._proofs.get(domain, {}), self._wanted.setdefault(domain, {})
        for entry in entries:
            if entry not in known and len(wanted) < MAX_PROOFS and len(entry) in _ENTRY_SIZES:
                wanted[entry] = None
        return [known.get(entry, b"") for entry in entries]

    def wanted_proofs(self, domain: str) -> list[bytes]:
        held = self.trust_status.foreign(domain)
        unproved = () if held is None else held.unproved
        return list(dict.fromkeys((*unproved, *self._wanted.get(domain, ()))))

    def add_proof(self, domain: str, entry: bytes, proof: bytes) -> None:
        held = self.trust_status.foreign(domain)
        if held is None or not is_tree(held.data):
            raise RevocationRefused("a proof, but there is no such tree")
        before = len(held.entries)
        held.add_proof(entry, proof)
        known = self._proofs.setdefault(domain, {})
        if len(known) >= MAX_PROOFS:
            known.clear()
        known[entry] = proof
        self._wanted.get(domain, {}).pop(entry, None)
        self.generation += len(held.entries) != before

    def admit(self, peer: Identity, now: int) -> None:
        # Return if a foreigner may open a connection; raises as `TrustStatus.check_peer`. The own master is
        # the source of the own list's freshness: that it is held is enough. A foreign master may come while
        # its domain's revocations are stale, or two masters that know nothing of each other yet would wait
        # for each other; it has no right until they are not.
        self.check_connected(peer, now)
        if is_master_name(peer.certified_name):
            return
        self.check_fresh(peer, now)

    def check_fresh(self, peer: Identity, now: int) -> None:
        for key in peer.keys:
            self.trust_status.check(peer.domain, key, now)

    def check_connected(self, peer: Identity, now: int) -> None:
        self.trust_status.check_trust(peer, now)
        stale: RevocationsStale | None = None
        for key in peer.keys:
            try:
                self.trust_status.check(peer.domain, key, now)
            except RevocationsStale as error:
                stale = stale or error
        if stale is None or is_master_name(peer.certified_name):
            self._stale_since.pop(peer.thumbprint, None)
        elif now - self._stale_since.setdefault(peer.thumbprint, now) >= GRACE:
            raise stale

    def check_known(self, domain: str, entry: bytes, now: int) -> None:
        with suppress(RevocationsStale):
            self.trust_status.check(domain, entry, now)

    def check_for(self, peer: Identity, entry: bytes, now: int) -> None:
        """As `check_known` with a foreigner's domain; nothing counts for a master that is stale."""
        self.check_known(peer.domain, entry, now)
        if is_master_name(peer.certified_name):  # `admit` did not ask
            self.check_fresh(peer, now)

    def label_of(self, domain: str) -> str:
        listed = self.anchors.listed_domain(domain)
        return "" if listed is None else listed.entry.label

    def domain_of(self, label: str) -> str | None:
        listed = self.anchors.listed(label)
        if listed is not None:
            return listed.entry.domain
        return OWN_DOMAIN if label in self.own_sites() else None

    def is_own_master(self, peer: Identity) -> bool:
        return (
            not peer.is_foreign
            and not peer.wildcard
            and is_master_name(peer.name)
            and peer.thumbprint in self._own_masters
        )

    def exported(self, domain: str) -> Reach | None:
        return self._exports.get(domain)

    def imported(self, label: str) -> Reach | None:
        return self._imports.get(label, _NOTHING)

    def verifier(self, domain: str) -> Verifier:
        """Opens grants of a listed foreign domain."""
        listed, held = self.anchors.listed_domain(domain), self.trust_status.foreign(domain)
        if listed is None or held is None:
            raise NotAdmitted(f"domain {domain!a} is not listed here")
        seq = 0 if held.current is None else held.current.seq
        check: RevocationCheck = partial(self.check_known, domain)
        delegates = self.trust_status.delegates(domain)
        return Verifier(listed.anchor.public_key, domain, delegates, seq, check)

    def own_delegates(self) -> tuple[ec.EllipticCurvePublicKey, ...]:
        """The keys of the listed own masters, unless revoked: their tickets count."""
        return self.trust_status.delegates(self.anchors.own.domain)

    def keep_only(self, thumbprints: frozenset[bytes]) -> None:
        self._stale_since = {key: since for key, since in self._stale_since.items() if key in thumbprints}

    def next_end(self, now: int) -> int | None:
        """When the trust in a listed domain ends next; None: never."""
        ends = [each.entry.until for each in self.anchors.all_listed if each.entry.until > now]
        return min(ends, default=None)

    def _roots(self) -> dict[str, bytes]:
        return {each.entry.domain: each.anchor.thumbprint for each in self.anchors.all_listed}

    def _data(self, domain: str) -> bytes:
        held = self.trust_status.foreign(domain)
        return b"" if held is None else held.data

    def _list_replaced(self, ended: frozenset[str]) -> None:
        for domain in ended:
            for held in (self._words, self._proofs, self._wanted):
                held.pop(domain, None)
        for listed in self.anchors.all_listed:
            domain = listed.entry.domain
            saved = None if self._data(domain) else self._load_foreign(domain)
            if saved is not None:
                self.trust_status.restore(domain, saved, 0)  # 0: of a tree nothing is proved
        self._own_masters = frozenset(map(thumbprint, self.anchors.masters))
        entries = [each.entry for each in self.anchors.all_listed]
        self._exports = {each.domain: _reach(each.exported) for each in entries}
        self._imports = {each.label: _reach(each.imported) for each in entries}
        self.generation += 1


def _reach(rules: tuple[NameRights, ...] | None) -> Reach | None:
    if rules is None:
        return None
    return Reach(Permission(pattern, Right(rights)) for pattern, rights in rules)
