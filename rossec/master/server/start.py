"""Creating a master from the directory of its node."""

import contextlib
import logging
import socket
from functools import partial
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import HintedError, RevocationRefused
from ca.keys.signer import Signer
from ca.revocation.state import Revocations
from ca.revocation.tree import is_tree
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.home import NodeHome
from rossec.master.operation.denial_log import OnDenial, ignore_denial
from rossec.master.operation.limits import MasterLimits
from rossec.master.rights.delegation import Delegate
from rossec.master.rights.deposits import verifier
from rossec.master.rights.domain_trust import DomainTrust
from rossec.master.rights.identity_renewals import Renewer
from rossec.master.rights.statements import TrustState
from rossec.master.server.deposit_file import DepositFile
from rossec.master.server.local_authority import (
    FindDomains,
    FindRevocations,
    no_authority,
    no_domains,
)
from rossec.master.server.own_identity import OwnIdentity
from rossec.master.server.parameter_file import ParameterFile
from rossec.master.server.saved_list import ListFile
from rossec.master.server.server import MasterServer
from rossec.ros.settings import is_loopback
from rossec.ros.text import printable
from rossec.saved_domains import DomainFiles
from rossec.saved_revocations import saved_revocations

_log = logging.getLogger("rossec.master.start")

_LIMITS: Final = MasterLimits()


def master_of(
    home: NodeHome,
    *,
    host: str | None,
    port: int,
    newest: bytes | None,
    now: int,
    entries: bytes | None = None,
    renewer: Renewer | None = None,
    on_denial: OnDenial = ignore_denial,
    limits: MasterLimits = _LIMITS,
    suites: tuple[int, ...] = PRODUCTION,
    find_revocations: FindRevocations = no_authority,
    find_domains: FindDomains = no_domains,
) -> MasterServer:
    """The master whose identity is in `home`, not yet started.

    Args:
        host: address to advertise (ROS_HOSTNAME or ROS_IP), and to listen on alone when it is
            loopback, as in ROS; None: this machine's name, and any address.
        newest: a revocation list that may be newer than the one saved, from an authority on this
            host; otherwise the master waits until one is published.
        renewer: renews identities with an intermediate of this host; None: the authority's service
            does, through the table of requests.
        entries: where `newest` is a tree, its entries.
        on_denial: called for every right that a caller lacks.
        limits: limits on what one peer may use.
        suites: the post-quantum policy (`rossec.channel.suite_selection`).
        find_revocations, find_domains: read what an authority on this host has signed.

    Raises:
        ConfigurationError: the node is not enrolled.
        CertificateRefused: its identity has expired: no node would connect.
        RevocationRefused: `newest` is not signed by the authority, or older than the one saved.
        DomainsRefused: the saved list of domains is not the authority's.
    """
    anchor, own_identity, saved_list = home.anchor(), OwnIdentity(home, now), ListFile(home)
    signer = own_identity.credentials.current.signer
    trust = _trust(home, saved_list, signer, newest, entries, renewer, now)
    own_key = home.identity(now).thumbprint
    own_identity.renew = lambda request, at: trust.identities.ask(own_key, request, at, trust.check)
    server = MasterServer(
        own_identity.credentials,
        trust.domains.anchors.verify,
        trust,
        name=home.name,
        host=host if host is not None and is_loopback(host) else None,
        port=port,
        advertise=host or socket.gethostname(),
        on_denial=on_denial,
        parameter_file=ParameterFile(home.path / "parameters.journal"),
        deposit_file=DepositFile(home.path / "deposits.journal", verifier(anchor, trust.check)),
        limits=limits,
        suites=suites,
        check_own_identity=partial(_maintain, own_identity, saved_list),
        find_revocations=find_revocations,
        find_domains=find_domains,
    )
    trust.identities.on_answered = partial(_take_own, server, own_key)
    return server


def _take_own(server: MasterServer, own_key: bytes, answered: bytes) -> None:
    """Have the master's own new identity taken at once."""
    if answered == own_key:
        server.effects.list_changed.set()


def _trust(
    home: NodeHome,
    saved_list: ListFile,
    signer: Signer,
    newest: bytes | None,
    entries: bytes | None,
    renewer: Renewer | None,
    now: int,
) -> TrustState:
    """What the authority has said, as far as this host knows; raises as `master_of`."""
    anchor = home.anchor()
    revocations = saved_revocations(home, anchor, now)
    if newest is not None:
        revocations.update(newest, now, saved_list.save)
    delegate = Delegate(anchor, signer, home.save_delegation)
    delegation = home.load_delegation()
    if delegation is not None:
        _load_delegation(delegate, delegation)
    trust = TrustState(
        anchor, signer, revocations, saved_list.save, delegate, saved_list.save_entries, renewer,
        _domains(home, anchor, revocations, saved_list, now),
    )  # fmt: skip
    _load_entries(trust, revocations, (entries, home.load_entries()), now)
    return trust


def _domains(
    home: NodeHome, anchor: TrustAnchor, own: Revocations, saved_list: ListFile, now: int
) -> DomainTrust:
    """The lists of foreign domains, and of what they revoked, as saved when the master stopped.

    Raises:
        DomainsRefused: the saved list is not the authority's.
    """
    saved = DomainFiles(home, anchor)
    standing = saved.standing(saved.anchors(), own, now)

    def load_foreign(domain: str) -> bytes | None:
        try:
            return saved.load_foreign(domain)
        except (HintedError, OSError) as error:
            _log.warning("the saved revocations of %s: %s", domain, printable(error))
            return None

    def save_foreign(domain: str, data: bytes) -> None:
        listed = standing.anchors.listed_domain(domain)
        if listed is not None:
            saved_list.save_by(("of", domain), partial(saved.save_foreign, listed.anchor), data)

    save = partial(saved_list.save_by, "domains", saved.save_domains)
    return DomainTrust(standing, save, save_foreign, load_foreign)


def _maintain(own_identity: OwnIdentity, saved_list: ListFile, now: int) -> None:
    own_identity.check(now)
    saved_list.retry()


def _load_delegation(delegate: Delegate, data: bytes) -> None:
    """A master with a new key starts all the same, without a valid delegation."""
    try:
        delegate.take(data)
    except HintedError as error:
        _log.warning("grants are not renewed: %s", error)


def _load_entries(
    trust: TrustState, revocations: Revocations, found: tuple[bytes | None, ...], now: int
) -> None:
    """Complete a tree with its entries: those of the authority or those saved."""
    if not is_tree(revocations.data):
        return
    for entries in found:
        if entries is not None:
            with contextlib.suppress(RevocationRefused):
                trust.update_tree(revocations.data, entries, now)
                return
    _log.warning("the entries of the revocation tree are missing: rossec ca publish")
