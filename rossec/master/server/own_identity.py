"""The master's own identity while it runs: renewed where possible, reloaded when replaced. A shell.

A master runs for months, its certificate is valid for one. So each maintenance round reloads a
certificate that was installed (`rossec node install`) and has it renewed like that of any node, by
the authority's service or by an intermediate here; while that does not succeed, it logs a warning.
The key stays the same: nodes identify their master by it.
"""

import logging
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity, build_request
from ca.errors import HintedError
from ca.renewal import renew_at, retry_delay, sign_renewal
from grants.validity import format_time
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master.rights.identity_renewals import RenewalAnswer
from rossec.ros.text import printable

_HOUR: Final = 3600
_RETRY: Final = 600
_GRACE: Final = 60  # seconds at most for the first answer
_log = logging.getLogger("rossec.master.own")

Renew = Callable[[bytes, int], RenewalAnswer]
"""Answers a renewal request with the new bundle, or with what is waited for."""


class OwnIdentity:
    """The credentials of the master; `check` keeps them current.

    Raises:
        CertificateRefused: the identity in `home` has expired, or is invalid.
        ConfigurationError: there is no identity, or it is another node's.
    """

    def __init__(self, home: NodeHome, now: int) -> None:
        self._home = home
        self._identity = home.identity(now)
        self._loaded_version = self._file_version()
        self._next_attempt = self._next_warning = 0
        self._csr = b""
        self.renew: Renew | None = None
        self.credentials = LiveCredentials(home.credentials())

    def check(self, now: int) -> None:
        """Reload a replaced identity, and renew one that is due; a failure is tried again."""
        self._attempt(self._reload, now)
        held = self._identity
        if now >= max(self._next_attempt, renew_at(held.not_before, held.not_after)):
            self._next_attempt = now + retry_delay(held.not_before, held.not_after, _RETRY)
            self._attempt(self._renew, now)

    def _attempt(self, action: Callable[[int], None], now: int) -> None:
        try:
            action(now)
        except (HintedError, OSError) as error:
            hint = f" ({error.hint})" if isinstance(error, HintedError) and error.hint else ""
            _log.warning("the master's own identity: %s%s", printable(error), hint)

    def _reload(self, now: int) -> None:
        version = self._file_version()
        if version == self._loaded_version:
            return
        self._loaded_version = version
        found = self._home.identity(now)
        if found.thumbprint != self._identity.thumbprint:
            raise ConfigurationError("the installed identity has another key", "restart the master")
        self._replace(found)

    def _replace(self, identity: Identity) -> None:
        self.credentials.current = self._home.credentials()
        self._identity, self._csr = identity, b""
        self._next_attempt = self._next_warning = 0
        _log.info("the master's own identity is valid until %s", format_time(identity.not_after))

    def _renew(self, now: int) -> None:
        own, held = self.credentials.current, self._identity
        if now > held.not_after or self.renew is None:
            self._warn("", now)
            return
        self._csr = self._csr or build_request(own.signer, held.domain, held.name)
        answer = self.renew(sign_renewal(own.signer, own.chain, self._csr, now), now)
        if answer.bundle:
            self._replace(self._home.install(answer.bundle, now))
            self._loaded_version = self._file_version()
            return
        self._next_attempt = now + 1  # in the next round, or as soon as there is an answer
        self._warn(f": {answer.status}", now)

    def _warn(self, why: str, now: int) -> None:
        """Once an hour, but not before a service that runs had time to answer.

        Raises:
            ConfigurationError: it is time.
        """
        held = self._identity
        if not self._next_warning and why:
            self._next_warning = now + retry_delay(held.not_before, held.not_after, _GRACE)
        if now < self._next_warning:
            return
        self._next_warning = now + retry_delay(held.not_before, held.not_after, _HOUR)
        verb, option = ("expires", "") if now <= held.not_after else ("expired", "--expired ")
        raise ConfigurationError(
            f"it {verb} {format_time(held.not_after)}, after which no node connects{why}",
            f"rossec ca renew {option}{held.name}, then rossec node install FILE here; no restart",
        )

    def _file_version(self) -> tuple[int, int, int]:
        found = (self._home.path / "node.pem").stat()
        return found.st_ino, found.st_mtime_ns, found.st_size
