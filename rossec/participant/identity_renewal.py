"""Renewal of a node's identity by the node itself, before it expires; `ca.renewal` has the rules.

The key stays, as grants are bound to it: there is one file to replace, which is done in one step.
New connections use the new certificate at once; existing ones end with the certificate they began
with. The same request is repeated until it is answered: the signer signs each request once, and
always answers it with the same certificate.
"""

import logging
from typing import Final

from ca.certificates import build_request
from ca.errors import CAError, HintedError
from ca.renewal import renew_at, retry_delay, sign_renewal
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.home import NodeHome
from rossec.participant.grant_renewal import MasterCall
from rossec.ros.text import printable

METHOD: Final = "rossec.renewIdentity"
RETRY: Final = 600  # seconds at most after a refusal: most masters have no intermediate

_log = logging.getLogger("rossec.node")


class IdentityRenewal:
    """The renewals of one node, for as long as it runs."""

    def __init__(self, home: NodeHome, credentials: LiveCredentials, now: int) -> None:
        self._home = home
        self._credentials = credentials
        self._identity = home.identity(now)
        self._csr = b""
        self._retry_at = 0

    def request(self, now: int) -> bytes | None:
        """The request to send now, if the identity is due; not again within `RETRY`."""
        held = self._identity
        due = renew_at(held.not_before, held.not_after)
        if now < max(due, self._retry_at):
            return None
        self._retry_at = now + retry_delay(held.not_before, held.not_after, RETRY)
        if self._was_replaced_on_disk(now):
            return None
        own = self._credentials.current
        self._csr = self._csr or build_request(own.signer, held.domain, held.name)
        return sign_renewal(own.signer, own.chain, self._csr, now)

    def _was_replaced_on_disk(self, now: int) -> bool:
        """Whether a newer certificate was installed meanwhile; if so, it is used from now on."""
        held = self._identity
        try:
            found = self._home.identity(now)
        except (HintedError, OSError):  # it has expired, or the files are being changed
            return False
        if found.thumbprint != held.thumbprint or found.not_after <= held.not_after:
            return False
        self._identity = found
        self._credentials.current = self._home.credentials()
        self._retry_at = 0
        _log.info("%s: the identity was renewed", found.name)
        return True

    def take(self, bundle: object, now: int) -> None:
        """Write a new identity to the disk, then use it.

        Raises:
            CAError, RossecError: it is invalid, or another node's; the old one stays.
        """
        if not isinstance(bundle, bytes):
            raise AnswerMalformed("an identity that is not bytes")
        self._identity = self._home.install(bundle, now)
        self._credentials.current = self._home.credentials()
        self._csr, self._retry_at = b"", 0
        _log.info("%s: the identity was renewed", self._identity.name)


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
    except (AnswerRefused, CAError) as error:
        _log.warning("the identity is not renewed: %s", printable(error))
        return False
    return True
