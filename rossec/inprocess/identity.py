"""The node that this process is: its identity, grants and revocation data; thread-safe.

One lock makes a list and its confirmation one step: between the two no revocation data would be
fresh, and every peer that is checked would be refused.
"""

from collections.abc import Callable
from dataclasses import replace
from threading import RLock

from ca.certificates import Identity
from grants.decision import Decision
from grants.model import Right
from rossec import clock
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.home import NodeHome
from rossec.net.context import SecureContext
from rossec.participant.access import Access, HeldGrant
from rossec.participant.connections import AuthorizedPeer, termination_reason
from rossec.saved_revocations import saved_revocations


class LockedAccess:
    """What this process uses of `Access`, one thread at a time.

    Not a subclass: a method that is added to `Access` cannot be called here without the lock.
    """

    def __init__(self, access: Access) -> None:
        self._access = access
        self.lock = RLock()

    @property
    def epoch(self) -> int:
        """See `Access.epoch`."""
        with self.lock:
            return self._access.epoch

    def hold(self, data: bytes) -> None:
        """See `Access.hold`."""
        with self.lock:
            self._access.hold(data)

    def hold_renewed(self, token: bytes, now: int) -> None:
        """See `Access.hold_renewed`."""
        with self.lock:
            self._access.hold_renewed(token, now)

    def held_grants(self) -> list[HeldGrant]:
        """See `Access.held_grants`."""
        with self.lock:
            return self._access.held_grants()

    def update_revocations(
        self,
        revocations: bytes,
        timestamp: bytes,
        master: Identity,
        now: int,
        persist: Callable[[bytes], None],
    ) -> None:
        """See `Access.update_revocations`."""
        with self.lock:
            self._access.update_revocations(revocations, timestamp, master, now, persist)

    def current(self, now: int) -> list[bytes]:
        """See `Access.current`."""
        with self.lock:
            return self._access.current(now)

    def present(self, right: Right, name: str, now: int) -> bytes:
        """See `Access.present`."""
        with self.lock:
            return self._access.present(right, name, now)

    def holds(self, right: Right, name: str, now: int) -> bool:
        """See `Access.holds`."""
        with self.lock:
            return self._access.holds(right, name, now)

    def check_peer(self, peer: Identity, now: int) -> None:
        """See `Access.check_peer`."""
        with self.lock:
            self._access.check_peer(peer, now)

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision:
        """See `Access.authorize`."""
        with self.lock:
            return self._access.authorize(peer, presented, right, name, now)


class LocalIdentity:
    """The enrolled node that this process is.

    Args:
        home: its directory.
        name: the name it runs under, which its identity covers.
        suites: of its channels, by the post-quantum policy.

    Raises:
        ConfigurationError: no identity, or another node's.
        CertificateRefused, KeyRefused: the identity or the key is invalid.
    """

    def __init__(self, home: NodeHome, name: str, suites: tuple[int, ...] = PRODUCTION) -> None:
        self.name = name
        self.home = home
        self.anchor = home.anchor()
        self.credentials = home.credentials()
        self.context = SecureContext(self.credentials, self.anchor.verify, suites=suites)
        self.identity = home.identity(now())
        self.revocations = saved_revocations(home, self.anchor, now())
        self.access = LockedAccess(Access(self.anchor, self.revocations))

    def take_revocations(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        """Take a list (empty: the one held) and the master's confirmation that it is the newest.

        Raises:
            CAError: either is invalid. A valid list is taken nevertheless.
        """
        with self.access.lock:
            self.access.update_revocations(
                data, timestamp, master, now(), self.home.save_revocations
            )

    def expire_confirmation(self) -> None:
        """Treat the master's confirmation as expired: the clock it was received by went back."""
        with self.access.lock:
            self.revocations.expire_confirmation(now() - 1)

    @property
    def unproved(self) -> list[bytes]:
        """Entries of a tree of revocations that wait for a proof."""
        with self.access.lock:
            return self.revocations.unproved

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """See `Revocations.add_proof`."""
        with self.access.lock:
            self.revocations.add_proof(entry, proof)

    def refresh_identity(self) -> bool:
        """Use the certificate that is in the directory now; returns whether it is another one.

        Raises:
            HintedError: it is invalid; the one before stays.
        """
        credentials = self.home.credentials()
        if credentials.chain == self.credentials.chain:
            return False
        self.identity, self.credentials = self.home.identity(now()), credentials
        self.context = replace(self.context, credentials=credentials)  # one step for other threads
        return True

    def termination_reason(self, connection: AuthorizedPeer) -> str | None:
        """Why a live connection must end now, if it must."""
        with self.access.lock:
            return termination_reason(connection, self.revocations, now())

    def is_revoked(self, peer: Identity) -> bool:
        """Whether the key of `peer`, or one in its chain, is on the list."""
        with self.access.lock:
            return not self.revocations.entries.isdisjoint(peer.keys)


def now() -> int:
    """The host's clock, in seconds; never ROS time (attack M7)."""
    return clock.now()
