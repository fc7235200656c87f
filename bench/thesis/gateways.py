"""The set-up of 5.2.2 and 5.2.4 with gateways: one copy for each site, copied behind the link.

Three sites, each a trust domain with a master of its own. The gateways of `s2` and `s3` have a
grant of `s1`, and are its only subscribers; the nodes of their sites subscribe to what they serve.
They reach the publisher by its address: by Ethernet over the switch, by radio over the lines.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from bench.thesis.network import ETHERNET, Device
from bench.thesis.programs import Program
from bench.thesis.setups import LISTENERS, PORT, SITES, TALKER, Setup, environ_of, site_of
from bench.thesis.talk import TOPIC
from grants.model import Right
from rossec.ros.names import MASTER
from tests.support.site import Site
from tests.support.trust import accept, carry, share

GATEWAY: Final = "/gateway"
ORIGIN: Final = SITES[0]
CLERK: Final = "/clerk"
IDLE: Final = "/idle"  # a topic of the clerk, on which nothing is sent
_SERVED: Final = f"/gateway/{ORIGIN}{TOPIC}"


class Gatewayed(Setup):
    """Each site's gateway is the one receiver there; `grants` are those of the gateways, by site.

    Attributes:
        clerk: a node of the origin that gives its master signed lists.
    """

    def start(self, kbit: int) -> None:
        """Start everything; the links between the sites have that rate."""
        directory = self.programs.directory
        self.sites = {each: Site(directory / each, each) for each in SITES}
        self.site = self.sites[ORIGIN]
        self._enroll()
        reached = self._links(kbit)
        for master in [self._start_master(each, reached) for each in SITES]:
            master.line()
        for gateway in [self._start_gateway(each) for each in SITES[1:]]:
            assert json.loads(gateway.line()) == {"ready": GATEWAY}
        self.start_nodes(f"/remote/{ORIGIN}{TOPIC}", links=len(SITES) - 1)
        for listener in self.listeners:
            listener.ask(links=1)
        self.clerk = self._node(ORIGIN, CLERK, "publish", IDLE)
        self.clerk.answer()

    def _enroll(self) -> None:
        """Enroll everybody; the origin and each other site trust each other."""
        for name, site in self.sites.items():
            site.enroll(MASTER).save_revocations(site.authority.store.newest_list() or b"")
            if name != ORIGIN:
                accept(site, self.site)
                accept(self.site, site)
                site.publish(GATEWAY, f"/gateway/{ORIGIN}/**")
                site.grant(GATEWAY, Right.GRAPH, "/**")
                self.grants[name] = share(self.site, site, GATEWAY, Right.SUBSCRIBE, TOPIC)
                share(self.site, site, MASTER, Right.GRAPH, "/**")
        self.site.publish(TALKER, TOPIC)
        self.site.publish(CLERK, IDLE)
        for number, listener in enumerate(LISTENERS, 1):
            self.sites[site_of(f"n{number}")].subscribe(listener, _SERVED)
        for site in self.sites.values():
            carry(site)

    def _links(self, kbit: int) -> dict[str, str]:
        """Where each site reaches the origin's master; by radio the publisher as well."""
        self.link = Device(self.network["s2"], "eth0")
        if kbit == ETHERNET:
            return dict.fromkeys(SITES[1:], self.network[ORIGIN].ipv4)
        found = {}
        for each in SITES[1:]:
            line, found[each] = self.network.line(ORIGIN, each, kbit)
            self.network.through(line, ORIGIN, found[each], "p")
            self.link = line if each == "s2" else self.link
        return found

    def _start_master(self, name: str, reached: Mapping[str, str]) -> Program:
        config = Path(self.programs.directory / f"{name}.yaml")
        others = (
            {ORIGIN: reached[name]}
            if name != ORIGIN
            else {each: self.network[each].ipv4 for each in SITES[1:]}
        )
        lines = [
            f"    {each}: {{uri: 'http://{at}:{PORT}', domain: {each}}}\n" for each, at in others.items()
        ]
        config.write_text("federation:\n  sites:\n" + "".join(lines))
        words = ("master", "--json", "-p", str(PORT), "--config", str(config))
        return self.programs.rossec(self.network[name], self.environ(name), *words)

    def _start_gateway(self, name: str) -> Program:
        words = ("gateway", "--json", "--from", ORIGIN, TOPIC)
        return self.programs.rossec(self.network[name], self.environ(name), *words)

    def environ(self, host: str) -> Mapping[str, str]:
        at = host if host in SITES else site_of(host)
        return environ_of(self.sites[at], self.network[host].ipv4, self.network[at].ipv4)

    def counted(self) -> int:
        return self.link.counters()[0]
