"""The node that this process is: its identity, grants and revocation data; thread-safe.

One lock makes a list and its confirmation one step: between the two no revocation data would be
fresh, and every peer that is checked would be refused.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from threading import RLock
from typing import Concatenate, ParamSpec, TypeVar

from ca.certificates import Identity
from rossec import clock
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.home import NodeHome
from rossec.net.context import SecureContext
from rossec.participant.access import Access
from rossec.participant.membership import LoadedIdentity
from rossec.participant.remote_names import caller_for
from rossec.ros.names import MASTER

P = ParamSpec("P")
R = TypeVar("R")


def _locked(
    method: Callable[Concatenate[Access, P], R],
) -> Callable[Concatenate["LockedAccess", P], R]:
    """The same method of `LockedAccess`."""

    @wraps(method)
    def call(locked: "LockedAccess", /, *args: P.args, **kwargs: P.kwargs) -> R:
        with locked.lock:
            value: R = getattr(locked._access, method.__name__)(*args, **kwargs)  # noqa: SLF001
            return value

    return call


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

    @property
    def unproved(self) -> list[bytes]:
        """See `Access.unproved`."""
        with self.lock:
            return self._access.unproved

    @property
    def foreign_domains(self) -> frozenset[str]:
        """See `Access.foreign_domains`."""
        with self.lock:
            return self._access.foreign_domains

    hold = _locked(Access.hold)
    hold_renewed = _locked(Access.hold_renewed)
    held_grants = _locked(Access.held_grants)
    update_revocations = _locked(Access.update_revocations)
    expire_confirmation = _locked(Access.expire_confirmation)
    add_proof = _locked(Access.add_proof)
    current = _locked(Access.current)
    present = _locked(Access.present)
    holds = _locked(Access.holds)
    is_master = _locked(Access.is_master)
    check_peer = _locked(Access.check_peer)
    authorize = _locked(Access.authorize)


class LocalIdentity(LoadedIdentity):
    """The enrolled node that this process is.

    Args:
        home, name, master: as of `LoadedIdentity`, which raises the same errors.
        suites: of its channels, by the post-quantum policy.
    """

    def __init__(
        self,
        home: NodeHome,
        name: str,
        suites: tuple[int, ...] = PRODUCTION,
        master: str = MASTER,
    ) -> None:
        super().__init__(home, name, master)
        self.live_context = SecureContext(
            self.live_credentials, self.anchors.verify, suites=suites, renews=Identity.renews
        )
        self.access = LockedAccess(Access(self.standing, master=master))

    def name_for(self, peer: Identity) -> str:
        """By which name this node calls itself to `peer`."""
        return caller_for(peer, self.name, self.identity.name)

    @property
    def credentials(self) -> Credentials:
        """Those of the next handshake, which uses them unchanged: it has a thread of its own."""
        return self.live_credentials.current

    @property
    def context(self) -> SecureContext[Identity]:
        """The context of the next handshake: a renewal by another thread does not change it."""
        return replace(self.live_context, credentials=self.credentials)

    def refresh_identity(self) -> bool:
        """Use the certificate that is in the directory now; returns whether it is another one.

        Raises:
            HintedError: it is invalid; the one before stays.
        """
        credentials = self.home.credentials()
        if credentials.chain == self.credentials.chain:
            return False
        self.identity = self.home.identity(now())
        self.live_credentials.current = credentials
        return True


def now() -> int:
    """The host's clock, in seconds; never ROS time (attack M7)."""
    return clock.now()
