"""What the commands of `rossec relay` share: the relay of this host, and what it knows."""

from contextlib import suppress
from typing import Final

from ca.domains.anchors import Anchors
from ca.errors import DomainsRefused
from rossec.authority.local_list import LocalList
from rossec.cli.shared.context import Environment
from rossec.environment import own_master, own_relay
from rossec.home import NodeHome
from rossec.overlay.relay_files import RelayFiles
from rossec.saved_domains import DomainFiles

ADMIN_SOCKET: Final = "admin.sock"


def relay_files(environment: Environment) -> RelayFiles:
    """The files of this host's relay, which need not be enrolled."""
    return RelayFiles(NodeHome.of(environment.home, own_relay(environment.variables)))


def known_domains(environment: Environment, home: NodeHome) -> Anchors:
    """The newest list of domains on this host: of the relay, its master, or the authority.

    Raises:
        ConfigurationError: the relay is not enrolled.
    """
    anchors = Anchors(home.anchor())
    master = NodeHome.of(environment.home, own_master(environment.variables))
    found = [DomainFiles(each, anchors.own).load_domains() for each in (home, master)]
    for data in (*found, LocalList(environment.home).domains()):
        if data:
            with suppress(DomainsRefused):  # of another authority, or older than one of the others
                anchors.update(data)
    return anchors
