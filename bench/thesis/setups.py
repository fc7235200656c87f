"""The set-ups of thesis 5.2.1 to 5.2.4: one publisher, six subscribers, direct or routed.

Direct (Figs. 5.1, 5.3): everybody on one switch, one master. Routed (Figs. 5.2, 5.4): three sites,
`s1` with the publisher, `s2` and `s3` with three subscribers each. By Ethernet all are on one
switch, whose ports are the links; by radio the two lines between the sites are links of their own.
Rows of another way between the sites are made by another subclass of `Setup`.
"""

import json
import secrets
import sys
from collections.abc import Mapping
from typing import Final

from bench._sites import enroll_masters
from bench.thesis.network import ETHERNET, Device, Testbed
from bench.thesis.programs import Program, Programs
from bench.thesis.talk import TOPIC
from rossec.overlay.documents import OPEN_ACCOUNT, Peer, Routers
from rossec.overlay.homes import RelayFiles
from rossec.overlay.link_frames import BOX, inbox
from rossec.ros.names import MASTER
from tests.support.site import Site

LISTENERS: Final = tuple(f"/listener{number}" for number in range(1, 7))
TALKER: Final = "/talker"
SITES: Final = ("s1", "s2", "s3")
HOSTS: Final = ("s1", "p", "n1", "n2", "n3", "n4", "n5", "n6")
ROUTED_HOSTS: Final = (*HOSTS, "s2", "s3")
PORT: Final = 11311
_ROUTER_PORT: Final = 7447


class Setup:
    """Running programs, and the link whose bytes are counted."""

    module = "bench.thesis.node"
    name = ""  # of the set-up

    def __init__(self, network: Testbed, running: Programs) -> None:
        self.network, self.programs = network, running
        self.talker: Program
        self.listeners: list[Program] = []
        self.link: Device
        self.grants: dict[str, bytes] = {}  # of each subscriber

    def environ(self, host: str) -> Mapping[str, str]:
        """The environment of a node on a host."""
        raise NotImplementedError

    def counted(self) -> int:
        """Bytes that have passed the link towards the subscribers."""
        raise NotImplementedError

    def join_domain(self, *masters: str) -> None:
        """Make one trust domain with these masters, whose nodes may talk."""
        self.site = Site(self.programs.directory / "site")
        enroll_masters(self.site, masters)
        self.site.publish(TALKER, TOPIC)
        self.grants = {each: self.site.subscribe(each, TOPIC) for each in LISTENERS}

    def start_nodes(self, topic: str = TOPIC, links: int = len(LISTENERS)) -> None:
        """Start the publisher and the subscribers, until all are connected.

        Args:
            topic: as the subscribers call it.
            links: how many connections the publisher has then.
        """
        self.talker = self._node("p", TALKER, "publish")
        self.talker.answer()
        hosts = HOSTS[2:]
        self.listeners = [
            self._node(host, name, "subscribe", *([topic] if topic != TOPIC else []))
            for host, name in zip(hosts, LISTENERS, strict=True)
        ]
        for each in self.listeners:
            each.answer()
        self.talker.ask(links=links)

    def _node(self, host: str, name: str, role: str, *topic: str) -> Program:
        command = (sys.executable, "-m", self.module, name, role, *topic)
        return self.programs.start(role, self.network[host], self.environ(host), *command)


class Direct(Setup):
    """Everybody connects straight to the publisher, sealed."""

    def start(self, kbit: int) -> None:
        """Start everything; the publisher's link has that rate."""
        self.link = self.network.limit("p", kbit)
        self.start_master()
        self.start_nodes()

    def start_master(self) -> None:
        """Start the only master."""
        self.join_domain(MASTER)
        master = self.programs.rossec(
            self.network["s1"], self.environ("s1"), "master", "--json", "-p", str(PORT)
        )
        master.line()

    def environ(self, host: str) -> Mapping[str, str]:
        return environ_of(self.site, self.network[host].ipv4, self.network["s1"].ipv4)

    def counted(self) -> int:
        return self.link.counters()[1]


class PlainDirect(Direct):
    """The same in plain ROS: rosmaster and rospy of this machine."""

    module = "bench.thesis.stock"

    def start_master(self) -> None:
        master = ("/usr/bin/rosmaster", "--core", "-p", str(PORT))
        self.programs.start("rosmaster", self.network["s1"], self.environ("s1"), *master)

    def environ(self, host: str) -> Mapping[str, str]:
        folder = str(self.programs.directory)
        return {
            "ROS_IP": self.network[host].ipv4,
            "ROS_HOME": folder,
            "ROS_LOG_DIR": folder,
            "ROS_MASTER_URI": f"http://{self.network['s1'].ipv4}:{PORT}/",
        }


class Relayed(Setup):
    """Each subscriber's own connection to the publisher is carried by relays and a router."""

    def __init__(self, network: Testbed, running: Programs) -> None:
        super().__init__(network, running)
        self.router_of: dict[str, str] = {}  # what the relay of a site uses first
        self._boxes: dict[tuple[str, str], str] = {}

    def start(self, kbit: int) -> None:
        """Start everything; the links between the sites have that rate."""
        self.masters = {each: MASTER if each == "s1" else f"{MASTER}/{each}" for each in SITES}
        self.join_domain(*self.masters.values())
        reached = self._links(kbit)
        self.routers = {f":{_ROUTER_PORT + number}": self._router(number) for number in range(2)}
        for each in SITES:
            self._join(each, reached[each])
        for master in [self._start_master(each) for each in SITES]:
            master.line()
        for name, relay in [(each, self._start_relay(each)) for each in SITES]:
            self.router_of[name] = json.loads(relay.line())["router"]
        self.start_nodes()

    def _links(self, kbit: int) -> dict[str, str]:
        """Where the routers are for each site: on `s1`."""
        if kbit == ETHERNET:
            self.link = Device(self.network["s2"], "eth0")
            return {"s1": "127.0.0.1", **dict.fromkeys(SITES[1:], self.network["s1"].ipv4)}
        self.link, address = self.network.line("s1", "s2", kbit)
        _, other = self.network.line("s1", "s3", kbit)
        return {"s1": "127.0.0.1", "s2": address, "s3": other}

    def _router(self, number: int) -> Program:
        home = str(self.programs.directory / f"router{number}")
        words = ["--home", home, "--listen", f"tcp/0.0.0.0:{_ROUTER_PORT + number}", "--open"]
        join = ["--join", f"tcp/127.0.0.1:{_ROUTER_PORT}"] if number else []
        started = self.programs.rossec(self.network["s1"], {}, "router", *words, *join, "--json")
        started.line()
        return started

    def _join(self, here: str, router: str) -> None:
        """Write the files of a relay: its account, and its peers, as exchanged cards would."""
        files = self._files(here)
        locators = tuple(f"tcp/{router}:{_ROUTER_PORT + number}" for number in range(2))
        files.keep_account(Routers(locators, OPEN_ACCOUNT).write())
        peers = [self._peer(here, there) for there in (SITES[1:] if here == "s1" else SITES[:1])]
        files.change(lambda found: found.update({each.label: each for each in peers}))

    def _peer(self, here: str, there: str) -> Peer:
        key = inbox(OPEN_ACCOUNT, bytes.fromhex(self._box(there, here)))
        return Peer(there, self._box(here, there), "", self._relay(there), key)

    def _start_master(self, name: str) -> Program:
        others = SITES[1:] if name == "s1" else SITES[:1]
        config = self.programs.directory / f"{name}.yaml"
        lines = [f"    {o}: {{via: {o}, master: {self.masters[o]}}}\n" for o in others]
        config.write_text("federation:\n  sites:\n" + "".join(lines))
        own = ("--json", "-p", str(PORT), "--config", str(config))
        named = () if name == "s1" else ("--name", self.masters[name])
        host = self.network[name]
        return self.programs.rossec(host, self.environ(name), "master", *own, *named)

    def _start_relay(self, name: str) -> Program:
        host = self.network[name]
        words = ("relay", "--bind", host.ipv4, "--json")
        return self.programs.rossec(host, self.environ(name), *words)

    def environ(self, host: str) -> Mapping[str, str]:
        at = host if host in SITES else site_of(host)
        own = environ_of(self.site, self.network[host].ipv4, self.network[at].ipv4)
        return {**own, "ROSSEC_MASTER": self.masters[at], "ROSSEC_RELAY": self._relay(at)}

    def counted(self) -> int:
        return self.link.counters()[0]

    def _files(self, name: str) -> RelayFiles:
        return RelayFiles(self.site.enroll(self._relay(name)))

    def _box(self, here: str, there: str) -> str:
        return self._boxes.setdefault((here, there), secrets.token_hex(BOX))

    @staticmethod
    def _relay(name: str) -> str:
        return "/relay" if name == "s1" else f"/relay/{name}"


def environ_of(site: Site, own: str, master: str) -> dict[str, str]:
    """The environment of a program of a site: addresses of its host and of its master."""
    return {"ROSSEC_HOME": str(site.root), "ROS_IP": own, "ROS_MASTER_URI": f"http://{master}:{PORT}/"}


def site_of(host: str) -> str:
    """The site that a host belongs to, when there are three."""
    if host == "p":
        return "s1"
    return "s2" if int(host[1:]) <= len(LISTENERS) // 2 else "s3"
