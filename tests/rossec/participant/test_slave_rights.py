"""Who may call what, decided before any handler runs (attacks N1-N5, L1)."""

from dataclasses import replace
from pathlib import Path

import pytest

from ca.errors import Revoked
from grants.errors import GrantMissing
from grants.model import Right
from rossec.errors import RossecError
from rossec.participant.access import Access
from rossec.participant.slave_api import MASTER_ONLY, SLAVE_CALLS, check_slave_call, is_relay
from rossec.ros.names import MASTER, PORTS
from tests.rossec.sidecar.agent_setup import AgentSetup
from tests.support.site import Site

NODE, VIEWER = "/robot", "/viewer"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def check(site: Site, method: str, peer: str, *grants: bytes) -> None:
    holder: Access = AgentSetup(site, peer).agent.access
    presented = None
    for data in grants:
        holder.hold(data)
        presented = holder.present(Right.GRAPH, NODE, site.now())
    access = AgentSetup(site, NODE).agent.access
    check_slave_call(method, site.identity(peer), NODE, presented, access, site.now())


@pytest.mark.parametrize("method", [*sorted(SLAVE_CALLS), *sorted(MASTER_ONLY), "requestTopic"])
def test_the_master_may_call_what_it_needs(site: Site, method: str) -> None:
    check(site, method, MASTER)


@pytest.mark.parametrize("method", sorted(MASTER_ONLY))
def test_only_the_master_sends_updates(site: Site, method: str) -> None:
    with pytest.raises(RossecError, match=f"{method} is for the master alone"):
        check(site, method, VIEWER)


def test_an_unknown_method_is_refused_for_the_master_too(site: Site) -> None:
    for peer in (MASTER, VIEWER):
        with pytest.raises(RossecError, match="no such method"):
            check(site, "registerSubscriber", peer)


def test_only_a_relay_learns_the_ports(site: Site) -> None:
    for relay in ("/relay", "/relay/kitchen"):
        check(site, PORTS, relay)
    granted = site.grant(VIEWER, Right.GRAPH, NODE)
    for peer in (VIEWER, MASTER):
        with pytest.raises(RossecError, match=f"{PORTS} is for a relay alone"):
            check(site, PORTS, peer, granted)
    own = site.identity("/relay")
    assert is_relay(own)
    assert not is_relay(replace(own, name="/remote/hospital/relay", certified="/relay"))


def test_an_operator_needs_the_right_on_this_node(site: Site) -> None:
    check(site, "requestTopic", VIEWER)
    with pytest.raises(GrantMissing):
        check(site, "getBusInfo", VIEWER)
    granted = site.grant(VIEWER, Right.GRAPH, NODE)
    check(site, "getBusInfo", VIEWER, granted)
    with pytest.raises(GrantMissing, match="admin"):
        check(site, "shutdown", VIEWER, granted)


def test_a_revoked_peer_may_call_nothing(site: Site) -> None:
    site.enroll(VIEWER)
    site.authority.revoke_identity(VIEWER, "stolen", site.now())
    with pytest.raises(Revoked):
        check(site, "requestTopic", VIEWER)
