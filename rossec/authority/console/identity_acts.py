"""Approving an identity for a node, and an intermediate.

The request that was shown is the one that is signed: its digest is in the statement. What was
approved while the key is locked is *approved* in the record, and can still be denied.
"""

import logging
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Final

from ca.approvals.statement import Enroll, Intermediate
from ca.authority import MAX_LIFETIME
from ca.certificates import check_request, to_pem
from ca.errors import HintedError, RequestClosed
from ca.intermediates import check_intermediate_request
from ca.keys.publickey import thumbprint
from ca.store.lifecycle import RequestState
from ca.store.record import CertificateRow, Store
from ca.store.rows import INTERMEDIATE
from rossec.authority import renewals
from rossec.authority.console.acts import Approved, Arguments, Conclude, ToApprove, tried
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.authority.signing import OWN_NODE
from rossec.errors import KeyServiceRefused
from rossec.ros.text import printable

MAX_SOURCE: Final = 256  # characters
_log = logging.getLogger("rossec.authority.service")


class EnrollAct:
    """An identity: CSR, where it came from, for anonymous nodes too, lifetime, replaces the key.

    `policy`: the file by which the node gets its first grants.
    """

    def __init__(self, policy: Path) -> None:
        self._policy = policy

    def prepare(self, service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """Check the request, and that its name is free; it is recorded, and waits."""
        match arguments:
            case [bytes(csr), str(source), bool(wildcard), int(lifetime), bool(replaces)]:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of an enrollment", "")
        asked = check_request(csr, service.home.domain, wildcard=wildcard)
        if asked.name == OWN_NODE:
            raise KeyServiceRefused(
                f"{OWN_NODE} is the authority's own node", "choose another name for the node"
            )
        _check_lifetime(lifetime)
        what = Enroll(asked.digest, asked.name, asked.thumbprint, wildcard, lifetime, replaces)
        with closing(service.home.store()) as store:
            if store.identities.issued_for(asked.digest) is None:
                store.requests.add(asked, csr, printable(source)[:MAX_SOURCE], now)
            with tried(store):
                _approve(store, what, now, "")
        return ToApprove(what, csr)

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """The request is *approved*."""
        _approve(store, _enrolled(approved), approved.approval.at, approved.reason)
        return None

    def carry_out(
        self, service: AuthorityService, approved: Approved, conclude: Conclude, now: int, /
    ) -> None:
        """Sign the identity; the node then gets what the policy gives its name."""
        what, authority = _enrolled(approved), service.unlock()
        with authority.store.transaction():
            _check_unchanged(authority.store, what, now)
            authority.issue(
                approved.approval.payload, now, what.lifetime,
                replace_key=what.name if what.replaces else None, wildcard=what.wildcard,
            )  # fmt: skip
            conclude(authority.store, f"{what.name} is enrolled")
        _grant_outright(service, what.name, self._policy)

    def made(self, service: AuthorityService, approved: Approved, /) -> bytes:
        """The identity bundle (PEM)."""
        with closing(service.home.store()) as store:
            found = store.identities.issued_for(_enrolled(approved).csr)
        return b"" if found is None else _bundle(service.home, found)


class IntermediateAct:
    """An intermediate: CSR, may enroll new nodes, lifetime."""

    def prepare(self, service: AuthorityService, arguments: Arguments, _now: int, /) -> ToApprove:
        """Check the request."""
        match arguments:
            case [bytes(csr), bool(enrolls), int(lifetime)]:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of an intermediate", "")
        home = service.home
        if home.is_intermediate:
            raise KeyServiceRefused("an intermediate makes no other", "do it at the root")
        _check_lifetime(lifetime)
        key = thumbprint(check_intermediate_request(csr, home.domain))
        with closing(home.store()) as store:
            store.identities.check_not_revoked("the intermediate", key)
        return ToApprove(Intermediate(sha256(csr).digest(), enrolls, lifetime), csr)

    def admit(self, _store: Store, _approved: Approved, /) -> str | None:
        """Nothing more to check: the digest of its request is approved."""
        return None

    def carry_out(
        self, service: AuthorityService, approved: Approved, conclude: Conclude, now: int, /
    ) -> None:
        """Sign it."""
        what, authority = approved.statement.what, service.unlock()
        assert isinstance(what, Intermediate)  # noqa: S101 - of this kind
        csr = approved.approval.payload
        with authority.store.transaction():
            name, _ = renewals.sign_intermediate(
                authority, csr, now, may_enroll=what.enrolls, lifetime=what.lifetime
            )
            conclude(authority.store, f"signed {name}")

    def made(self, service: AuthorityService, approved: Approved, /) -> bytes:
        """Its bundle (PEM): the newest for its key."""
        home = service.home
        key = thumbprint(check_intermediate_request(approved.approval.payload, home.domain))
        with closing(home.store()) as store:
            found = store.identities.by_name(f"{INTERMEDIATE}{key.hex()[:16]}")
        return _bundle(home, found[-1]) if found else b""


def _enrolled(approved: Approved) -> Enroll:
    what = approved.statement.what
    assert isinstance(what, Enroll)  # noqa: S101 - of this kind
    return what


def _approve(store: Store, what: Enroll, at: int, reason: str) -> None:
    """Approve the recorded request; one that was answered before gets the same answer.

    Raises:
        RequestClosed: it was approved or denied meanwhile, or has expired.
        KeyChanged, NameContested, NameCovered, StoreError: as `RequestTable.approve`.
    """
    if store.identities.issued_for(what.csr) is not None:
        store.identities.check_not_revoked(what.name, what.key)
        return
    if store.requests.find(what.csr) is None:
        raise RequestClosed("the request has expired", "make a new request on the node")
    replaced = what.name if what.replaces else None
    store.requests.approve(what.csr, at, reason, replace_key=replaced, wildcard=what.wildcard)


def _check_unchanged(store: Store, what: Enroll, now: int) -> None:
    """Return if the request is still approved as it was, or was answered before.

    Raises:
        RequestClosed: it was denied, or has expired.
    """
    if store.identities.issued_for(what.csr) is not None:
        return
    row = store.requests.find(what.csr)
    expired = row is None or now > row.expires
    if row is None or expired or row.state is not RequestState.APPROVED:
        state = "has expired" if row is None or expired else f"was {row.state}"
        because = "" if row is None or expired or not row.reason else f": {row.reason}"
        raise RequestClosed(f"the request of {what.name} {state}{because}", "ask the node again")
    if (row.wildcard, row.replaces) != (what.wildcard, what.replaces):
        raise RequestClosed(f"the request of {what.name} was approved otherwise", "look at it")


def _check_lifetime(lifetime: int) -> None:
    if not 0 < lifetime <= MAX_LIFETIME:
        raise KeyServiceRefused(
            f"a lifetime of {lifetime} s where 1 to {MAX_LIFETIME} are allowed", ""
        )


def _bundle(home: AuthorityHome, row: CertificateRow) -> bytes:
    own = home.intermediate()
    return to_pem(row.der, *([] if own is None else [own]), home.anchor().certificate)


def _grant_outright(service: AuthorityService, name: str, policy: Path) -> None:
    """What the policy gives the name; the identity is signed by then, so a mistake is logged."""
    try:
        for _, data in service.grant_outright(name, place=policy):
            service.store_grant(data)
    except HintedError as error:
        _log.error("%s has no grants yet: %s", name, printable(str(error)))
