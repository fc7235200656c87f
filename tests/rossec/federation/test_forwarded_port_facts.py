"""Facts with forwarded ports for addresses."""

import pytest

from rossec.errors import ImportRefused
from rossec.federation.site_state import ForwardedPortFacts, SiteChange
from rossec.master.state.forwarded_ports import NODE, SERVICE, ForwardedPort, Target
from rossec.master.state.imported_facts import FACTS_LIMIT, Fact

ROBOT, CLOCK = Target("office", NODE, "/robot"), Target("office", SERVICE, "/clock")
SAID = (
    ("node", "/robot", "http://10.0.0.2:4711/"),
    ("provider", "/clock", "rosrpc://10.0.0.2:9"),
    ("publisher", "/pose", "/robot"),
    ("type", "/pose", "std_msgs/String"),
)
PLAIN = set(SAID[2:])
NOTHING = SiteChange(frozenset(), frozenset(), False, b"", b"")
FORWARDED_PORT_FACTS = {
    ("node", "/robot", "http://127.0.0.1:7001/via"),
    ("provider", "/clock", "rosrpc://127.0.0.1:7002"),
}


class Said:
    """What an office says, and forwarded ports that a test opens."""

    def __init__(self) -> None:
        self.forwarded_ports: dict[Target, ForwardedPort] = {}
        self.facts = ForwardedPortFacts("office", self.forwarded_ports.get)

    def take(self, *added: Fact, removed: tuple[Fact, ...] = (), whole: bool = False) -> SiteChange:
        change = SiteChange(frozenset(added), frozenset(removed), whole, b"", b"")
        for _ in self.facts.take(change):
            pass
        return self.facts.shown(change)

    def refreshed(self) -> SiteChange:
        return self.facts.shown(NOTHING)

    def open(self) -> None:
        self.forwarded_ports |= {
            ROBOT: ForwardedPort("127.0.0.1", 7001),
            CLOCK: ForwardedPort("127.0.0.1", 7002),
        }


@pytest.fixture
def said() -> Said:
    return Said()


def test_an_address_is_shown_when_its_forwarded_port_is_open(said: Said) -> None:
    assert said.take(*SAID, whole=True).added == PLAIN
    assert said.facts.targets == {ROBOT, CLOCK}
    said.open()
    assert said.refreshed().added == FORWARDED_PORT_FACTS
    assert said.refreshed() == NOTHING


def test_forwarded_ports_that_are_there_already_are_shown_at_once(said: Said) -> None:
    said.open()
    change = said.take(*SAID, whole=True)
    assert change == SiteChange(frozenset(PLAIN | FORWARDED_PORT_FACTS), frozenset(), True, b"", b"")
    said.forwarded_ports[Target("office", NODE, "/arm")] = ForwardedPort("fd00::1", 7003)
    more = said.take(("node", "/arm", "http://10.0.0.3:1/"))
    assert more.added == {("node", "/arm", "http://[fd00::1]:7003/via")}
    assert said.take(*SAID, whole=True).added == PLAIN | FORWARDED_PORT_FACTS


def test_a_node_that_moved_there_stays_at_its_forwarded_port(said: Said) -> None:
    said.open()
    said.take(*SAID, whole=True)
    moved = said.take(("node", "/robot", "http://10.0.0.9:1/"), removed=SAID[:1])
    assert moved == NOTHING


def test_what_is_gone_there_is_gone_here(said: Said) -> None:
    said.open()
    said.take(*SAID, whole=True)
    change = said.take(removed=(SAID[0], SAID[2]))
    assert change.removed == {("node", "/robot", "http://127.0.0.1:7001/via"), SAID[2]}
    assert said.facts.targets == {CLOCK}


def test_a_forwarded_port_that_is_gone_counts_until_there_is_another(said: Said) -> None:
    said.open()
    said.take(*SAID, whole=True)
    said.forwarded_ports.clear()
    assert said.refreshed() == NOTHING
    said.forwarded_ports[ROBOT] = ForwardedPort("127.0.0.1", 8001)
    change = said.refreshed()
    assert change.added == {("node", "/robot", "http://127.0.0.1:8001/via")}
    assert change.removed == {("node", "/robot", "http://127.0.0.1:7001/via")}


def test_a_place_that_is_anothers_forwarded_port_now_does_not_count(said: Said) -> None:
    said.open()
    said.take(*SAID, whole=True)
    said.forwarded_ports.clear()
    said.forwarded_ports[CLOCK] = ForwardedPort("127.0.0.1", 7001)
    change = said.refreshed()
    assert change.added == {("provider", "/clock", "rosrpc://127.0.0.1:7001")}
    assert change.removed == FORWARDED_PORT_FACTS


def test_after_a_drop_everything_is_shown_again(said: Said) -> None:
    said.open()
    said.take(*SAID, whole=True)
    said.facts.forget()
    assert said.facts.targets == set()
    assert said.take(*SAID, whole=True).added == PLAIN | FORWARDED_PORT_FACTS


@pytest.mark.parametrize(
    "wrong",
    [
        ("node", "robot", "http://10.0.0.2:1/"),
        ("node", "/remote/x/robot", "http://10.0.0.2:1/"),
        ("node", "/robot", "10.0.0.2"),
        ("provider", "/clock", "http://10.0.0.2:1/"),
        ("forwarded_port", "/robot", "http://10.0.0.2:1/"),
    ],
)
def test_no_forwarded_port_is_wanted_of_what_is_malformed(said: Said, wrong: Fact) -> None:
    said.take(*SAID[:1])
    with pytest.raises(ImportRefused):
        said.take(wrong, *SAID)
    assert said.facts.targets == {ROBOT}


def test_addresses_are_bounded(said: Said) -> None:
    many = [("node", f"/n{number}", "http://10.0.0.2:1/") for number in range(FACTS_LIMIT + 1)]
    with pytest.raises(ImportRefused, match="more than"):
        said.take(*many)
    assert said.facts.targets == set()
