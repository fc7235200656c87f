"""Forwarded ports of relays: wanted by followers, opened by the relay that serves a peer."""

from collections.abc import Mapping

import pytest

from rossec.master.state.forwarded_ports import (
    AT_ONCE,
    SILENCE,
    ForwardedPort,
    ForwardedPorts,
    PeerWay,
    RelayReport,
    Target,
    WantedChange,
)
from rossec.master.state.registry import endpoint

MASTER = Target("office", "master", "/master")
ROBOT = Target("office", "node", "/robot")
CLOCK = Target("office", "service", "/clock")
AT = ForwardedPort("127.0.0.1", 7001)
WAY = PeerWay("idle", 0.0, 0, "tls/router:7447", 0)


class Site:
    """A relay of each name that polls as it should, and what the forwarded ports have called."""

    def __init__(self, limit: int = 100) -> None:
        self.forwarded_ports = ForwardedPorts(limit)
        self.seen: dict[str, int] = {}
        self.told = self.changed = 0
        self.forwarded_ports.on_wanted = self._tell
        self.forwarded_ports.listen("office", self._change)

    def _tell(self) -> None:
        self.told += 1

    def _change(self) -> None:
        self.changed += 1

    def poll(
        self,
        relay: str = "/relay",
        opened: Mapping[Target, ForwardedPort] | None = None,
        *,
        instance: str = "one",
        peers: tuple[str, ...] = ("office",),
        now: int = 0,
    ) -> WantedChange:
        report = RelayReport(instance, self.seen.get(relay, 0), opened or {}, dict.fromkeys(peers, WAY))
        change = self.forwarded_ports.hear(relay, report, now)
        self.seen[relay] = change.version
        return change


def test_what_a_follower_wants_is_told_once_and_masters_first() -> None:
    site = Site()
    assert site.forwarded_ports.want("office", [ROBOT, CLOCK, MASTER]) == 0
    assert site.told == 1
    assert site.poll().wanted == (MASTER, ROBOT, CLOCK)
    assert site.poll() == WantedChange(site.seen["/relay"], (), ())
    site.forwarded_ports.want("office", [ROBOT, CLOCK, MASTER])
    assert site.poll().wanted == ()


def test_a_forwarded_port_that_was_opened_is_found() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.poll()
    assert site.forwarded_ports.forwarded_port(ROBOT) is None
    before = site.changed
    site.poll(opened={ROBOT: AT})
    assert site.forwarded_ports.forwarded_port(ROBOT) == AT
    assert site.changed == before + 1
    assert site.forwarded_ports.is_forwarded_port(endpoint("http://127.0.0.1:7001/anything"))
    assert not site.forwarded_ports.is_forwarded_port(endpoint("http://127.0.0.1:7002/"))
    site.poll(opened={ROBOT: AT})
    assert site.changed == before + 1


def test_what_nobody_wants_is_no_forwarded_port() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.poll(opened={CLOCK: AT})
    assert site.forwarded_ports.forwarded_port(CLOCK) is None


def test_a_target_is_wanted_until_its_last_site_wants_it_no_longer() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.forwarded_ports.want("other", [ROBOT])
    site.poll(opened={ROBOT: AT})
    site.poll(opened={ROBOT: AT})
    site.forwarded_ports.want("other", [])
    assert site.poll().unwanted == ()
    site.forwarded_ports.forget("office")
    assert site.poll().unwanted == (ROBOT,)
    assert site.forwarded_ports.forwarded_port(ROBOT) is None
    assert not site.forwarded_ports.is_forwarded_port(AT.endpoint)
    site.forwarded_ports.want("office", [ROBOT])
    assert site.poll() == WantedChange(site.seen["/relay"], (ROBOT,), ())


def test_a_place_is_the_forwarded_port_of_one_target() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT, CLOCK])
    site.poll(opened={ROBOT: AT})
    site.poll(opened={CLOCK: ForwardedPort("127.0.0.1", 7001)})
    assert site.forwarded_ports.forwarded_port(ROBOT) is None
    assert site.forwarded_ports.forwarded_port(CLOCK) == AT
    site.poll(opened={CLOCK: ForwardedPort("127.0.0.1", 7002)})
    assert not site.forwarded_ports.is_forwarded_port(AT.endpoint)


def test_a_relay_that_was_started_again_is_told_of_everything() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.poll()
    site.poll(opened={ROBOT: AT})
    assert site.poll(instance="two").wanted == (ROBOT,)
    assert site.forwarded_ports.forwarded_port(ROBOT) is None


def test_a_relay_that_has_seen_more_than_this_run_of_the_master_is_told_of_everything() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.seen["/relay"] = 1000
    assert site.poll().wanted == (ROBOT,)


def test_a_silent_relay_is_forgotten_and_another_serves_its_peers() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.poll("/relay", now=0)
    site.poll("/relay", {ROBOT: AT}, now=0)
    assert site.poll("/relay/spare", now=10).wanted == ()
    assert site.forwarded_ports.expire(SILENCE) == ()
    assert site.forwarded_ports.expire(SILENCE + 1) == ("/relay",)
    assert site.forwarded_ports.forwarded_port(ROBOT) is None
    assert site.forwarded_ports.way("office") == ("/relay/spare", WAY)
    assert site.poll("/relay/spare", now=20).wanted == (ROBOT,)
    site.poll("/relay/spare", {ROBOT: AT}, now=20)
    assert site.forwarded_ports.forwarded_port(ROBOT) == AT
    assert site.poll("/relay", now=30).wanted == ()  # the other serves it, while it is there


def test_a_relay_without_the_peer_has_no_forwarded_port_there() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    assert site.poll(peers=("ward",)).wanted == ()
    assert site.forwarded_ports.way("office") is None
    assert site.poll(peers=("office", "ward")).wanted == (ROBOT,)
    site.poll(opened={ROBOT: AT})
    site.poll(peers=())
    assert site.forwarded_ports.forwarded_port(ROBOT) is None
    assert not site.forwarded_ports.is_forwarded_port(AT.endpoint)


def test_many_targets_are_told_in_parts() -> None:
    site = Site(limit=5 * AT_ONCE)
    many = {Target("office", "node", f"/n{number}") for number in range(2 * AT_ONCE + 10)}
    site.forwarded_ports.want("office", many)
    parts = [site.poll().wanted for _ in range(4)]
    assert [len(part) for part in parts] == [AT_ONCE, AT_ONCE, 10, 0]
    assert {target for part in parts for target in part} == many


def test_more_than_a_relay_has_forwarded_ports_is_not_wanted() -> None:
    site = Site(limit=2)
    assert site.forwarded_ports.want("office", [ROBOT, CLOCK, MASTER]) == 1
    assert MASTER in site.poll().wanted
    site.forwarded_ports.want("office", [MASTER])
    assert site.forwarded_ports.want("office", [MASTER, CLOCK]) == 0
    assert site.poll().wanted == (CLOCK,)


def test_no_site_takes_the_forwarded_ports_of_the_next_one() -> None:
    """What there is at a site, it says itself."""
    site = Site(limit=64)
    for number in range(1, 4):
        peer = f"s{number}"
        claimed = {Target(peer, "node", f"/n{each}") for each in range(1000)}
        master = Target(peer, "master", "/master")
        assert site.forwarded_ports.want(peer, claimed | {master}) < 1000
        assert master in site.poll(peers=(peer,)).wanted
    honest = [Target("honest", kind, "/master") for kind in ("master", "node", "service")]
    assert site.forwarded_ports.want("honest", honest) == 0


def test_what_was_wanted_is_forgotten_within_limits() -> None:
    site = Site(limit=2)
    for number in range(9):
        site.forwarded_ports.want("office", [Target("office", "node", f"/n{number}")])
    assert len(site.poll().unwanted) == 2


@pytest.mark.parametrize("count", [63, 64])
def test_there_are_at_most_so_many_relays(count: int) -> None:
    site = Site()
    for number in range(count):
        site.poll(f"/relay/r{number}")
    assert site.forwarded_ports.has_room_for("/relay/r0")
    assert site.forwarded_ports.has_room_for("/relay/new") is (count < 64)


def test_nobody_is_told_after_it_is_followed_no_longer() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.forwarded_ports.forget("office")
    before = site.changed
    site.poll()
    assert site.changed == before


def test_of_two_relays_with_one_name_the_newer_one_is_heard() -> None:
    site = Site()
    site.forwarded_ports.want("office", [ROBOT])
    site.poll(instance="one")
    assert not site.forwarded_ports.is_superseded("/relay", "one")
    site.poll(opened={ROBOT: AT}, instance="two", now=1)
    assert site.forwarded_ports.is_superseded("/relay", "one")
    assert not site.forwarded_ports.is_superseded("/relay", "two")
    assert not site.forwarded_ports.is_superseded("/relay/attic", "one")
    assert site.forwarded_ports.expire(2 + SILENCE) == ("/relay",)
    assert not site.forwarded_ports.is_superseded("/relay", "one"), "it may serve again"
