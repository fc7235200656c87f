"""Renewal of a node's identity by the node itself, before it expires; `ca.renewal` has the rules.

The key stays, as grants are bound to it: there is one file to replace, which is done in one step.
The new certificate is presented on open connections (`rossec.net.open_streams`), and used for new
ones. The same request is repeated until it is answered: the signer signs each request once, and
always answers it with the same certificate. A certificate that somebody installs is used as well,
also after the own one has ended: no master answers by then.
"""

import logging
from typing import Final

from ca.certificates import Identity, build_request
from ca.errors import CAError, HintedError
from ca.renewal import renew_at, retry_delay, sign_renewal
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.clock import format_duration
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.home import NodeHome
from rossec.own_validity import ended
from rossec.participant.grant_renewal import MasterCall
from rossec.ros.names import RENEW_IDENTITY
from rossec.ros.text import printable

METHOD: Final = RENEW_IDENTITY
RETRY: Final = 600  # seconds at most after a refusal
FIRST_PAUSE: Final = 5  # seconds after the first request that has no answer yet; then doubled up to
LONGEST_PAUSE: Final = 60
WARN_EVERY: Final = 3600  # seconds at most between two warnings
_PENDING: Final = 0  # ROS's code: nothing was wrong with the call

_log = logging.getLogger("rossec.node")


class IdentityRenewal:
    """The renewals of one node, for as long as it runs."""

    def __init__(self, home: NodeHome, credentials: LiveCredentials, now: int) -> None:
        self._home = home
        self._credentials = credentials
        self._identity = home.identity(now)
        self._version = self._file_version()
        self._csr = b""
        self._retry_at = self._warn_at = 0
        self._pause = FIRST_PAUSE
        self._elapsed = clock.counter()
        self._began = now, self._elapsed()

    def request(self, now: int) -> bytes | None:
        """The request to send now, if the identity is due; not again before it is worthwhile."""
        held = self._identity
        due = renew_at(held.not_before, held.not_after)
        if self._retry_at > now + RETRY:  # by a clock that was ahead
            self._retry_at = self._warn_at = 0
        if now < max(due, self._retry_at):
            return None
        self._retry_at = now + retry_delay(held.not_before, held.not_after, RETRY)
        if self.take_installed(now):
            return None
        own = self._credentials.current
        self._csr = self._csr or build_request(own.signer, held.domain, held.name)
        return sign_renewal(own.signer, own.chain, self._csr, now)

    def take_installed(self, now: int) -> bool:
        """Use a newer certificate that was installed meanwhile; returns whether there is one."""
        version = self._file_version()
        if version == self._version:
            return False
        held = self._identity
        try:
            found = self._home.identity(now)
        except (HintedError, OSError):  # it has expired, or the files are being changed
            return False
        self._version = version
        if found.thumbprint != held.thumbprint or found.not_after <= held.not_after:
            return False
        self._use(found)
        return True

    def take(self, bundle: object, now: int) -> None:
        """Write a new identity to the disk, then use it.

        Raises:
            CAError, RossecError: it is invalid, or another node's; the old one stays.
        """
        if not isinstance(bundle, bytes):
            raise AnswerMalformed("an identity that is not bytes")
        self._use(self._home.install(bundle, now))
        self._version = self._file_version()

    def refused(self, error: AnswerRefused, now: int) -> None:
        """Say why there is no new identity; where it is only not there yet, ask again soon."""
        held, text = self._identity, printable(error)
        if error.code != _PENDING:
            _log.warning("the identity is not renewed: %s", text)
            return
        longest = min(self._pause, RETRY)
        self._retry_at = now + retry_delay(held.not_before, held.not_after, longest)
        is_first, self._pause = self._pause == FIRST_PAUSE, min(2 * self._pause, LONGEST_PAUSE)
        level = logging.WARNING if now >= self._warn_at and not is_first else logging.INFO
        left = format_duration(max(0, held.not_after - now))
        what = f"the identity ends in {left} and is not renewed yet"
        _log.log(level, "%s: %s: %s", held.name, what, text)
        if level == logging.WARNING:
            self._warn_at = now + retry_delay(held.not_before, held.not_after, WARN_EVERY)

    def ended(self, now: int) -> str:
        """What is to be said when the identity is over: no peer takes it any more; else empty."""
        if now <= self._identity.not_after:
            return ""
        began, counted = self._began
        passed = began + int(self._elapsed() - counted)  # whatever the clock was set to meanwhile
        chain, anchor = self._credentials.current.chain, self._home.anchor()
        error = ended(self._identity.name, chain, anchor, now, passed)
        return f"{error} ({error.hint})"

    def _use(self, identity: Identity) -> None:
        self._identity = identity
        self._credentials.current = self._home.credentials()
        self._csr, self._retry_at, self._warn_at, self._pause = b"", 0, 0, FIRST_PAUSE
        _log.info("%s: the identity was renewed", identity.name)

    def _file_version(self) -> tuple[int, int, int]:
        """Which certificate is on the disk; zeros: none."""
        try:
            found = (self._home.path / "node.pem").stat()
        except OSError:
            return 0, 0, 0
        return found.st_ino, found.st_mtime_ns, found.st_size


async def renew_identity(call: MasterCall, renewal: IdentityRenewal, now: int) -> bool:
    """Renew the identity if it is due; returns whether it was renewed.

    Raises:
        RossecError: the master is out of reach.
    """
    request = renewal.request(now)
    if request is None:
        return False
    try:
        renewal.take(await call(METHOD, request), now)
    except AnswerRefused as error:
        renewal.refused(error, now)
        return False
    except CAError as error:
        _log.warning("the identity is not renewed: %s", printable(error))
        return False
    return True
