"""A hospital and a home that trust each other, and programs of every form at both.

The programs are those of `test_pairings`: what those of the home subscribe to and call is below
/remote/hospital.
"""

import contextlib
import itertools
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from grants.model import Right
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.support.hosts import Host, Hosts
from tests.support.kinds import KINDS, LISTENERS, SPEAKERS, command
from tests.support.site import Site, coarse
from tests.support.trust import accept, carry, share

LABEL: Final = "remote/hospital"
TOOL: Final = ("--as", "/rostopic")
PAIRS: Final = tuple(itertools.product(KINDS, KINDS))
pairs = pytest.mark.parametrize(
    ("source", "sink"), PAIRS, ids=[f"{source}-to-{sink}" for source, sink in PAIRS]
)


@dataclass(frozen=True)
class Cast:
    """Both sides, the programs of the hospital that speak, and those of the home that listen."""

    home: World
    hospital: World
    speakers: Mapping[str, Running]
    listeners: Mapping[str, Running]

    def tool(self, *words: str) -> str:
        """The output of a stock tool of the home."""
        return self.home.tool(*words, options=TOOL)


def world(directory: Path, domain: str, host: Host | None = None) -> World:
    """A site on this host, or on that one."""
    loopback = host or Host((), "127.0.0.1", "::1")
    logs = directory / f"{domain}.logs"
    logs.mkdir()
    return World(Hosts(loopback, loopback, real=False), Site(directory / domain, domain), logs)


def prepare(home: World, hospital: World) -> None:
    """Who may do what; lists of domains are in every home."""
    accept(home.site, hospital.site, "hospital")
    accept(hospital.site, home.site, "home")
    for kind in KINDS:
        hospital.enroll(f"/{kind}_speaker", publish=f"/{kind}/*", provide=f"/{kind}/*")
        listener = f"/{kind}_listener"
        home.enroll(listener)
        for right, pattern in (
            (Right.SUBSCRIBE, "/*/words"),
            (Right.SUBSCRIBE, "/*/latched"),
            (Right.CALL, "/*/switch"),
        ):
            share(hospital.site, home.site, listener, right, pattern)
        share(hospital.site, home.site, listener, Right.SUBSCRIBE, "/*/pose", coarse())
    for name in ("/tool", "/rostopic"):  # one name, and any: rostopic makes one up
        home.enroll(
            name, wildcard=name == "/rostopic", graph="/**", publish="/**", param_set="/**", provide="/**"
        )
        for right in (Right.SUBSCRIBE, Right.CALL, Right.GRAPH):
            share(hospital.site, home.site, name, right, "/**")
    share(hospital.site, home.site, "/master", Right.GRAPH, "/**")
    share(home.site, hospital.site, "/master", Right.GRAPH, "/master")
    for side in (home, hospital):
        carry(side.site)


def follow(other: World, way: str) -> tuple[str, ...]:
    """Options of a master that follows that of the other domain; `way`: its place, as YAML."""
    label, config = other.site.anchor.domain, other.directory / "followed.yaml"
    config.write_text(f"federation:\n  sites:\n    {label}: {{{way}, domain: {label}}}\n")
    return "--config", str(config)


@contextlib.contextmanager
def running_programs(home: World, hospital: World, never: Path, pause: float = 0.1) -> Iterator[Cast]:
    """The programs of both sites, whose masters run; `pause`: seconds between messages."""
    with contextlib.ExitStack() as stack:

        def start(side: World, kind: str, source: str, *more: str) -> Running:
            line = command(kind, sys.executable, ROSSEC, source, *more)
            return stack.enter_context(side.started(side.hosts.near, *line))

        speakers = {kind: start(hospital, kind, SPEAKERS[kind], str(pause)) for kind in KINDS}
        for speaker in speakers.values():
            speaker.wait_for("READY")
        for kind in KINDS:  # until then they refuse a foreigner, and `wait_for_service` ends
            known = hospital.site.root / "nodes" / f"{kind}_speaker" / "foreign" / "home.cose"
            wait(known.exists)
        told = " ".join(f"{LABEL}/{kind}" for kind in KINDS), str(never)
        listeners = {kind: start(home, kind, LISTENERS[kind], *told) for kind in KINDS}
        yield Cast(home, hospital, speakers, listeners)
