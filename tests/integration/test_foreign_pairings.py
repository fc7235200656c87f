"""Every form of a node reaches those of another domain, and stock tools behind a sidecar do.

A hospital and a home trust each other; each has a master, and the home's follows the hospital's.
The programs are those of `test_pairings`: what they subscribe to and call is below
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
from tests.support.kinds import KINDS, LISTENERS, SEEN, SPEAKERS, command
from tests.support.site import Site, coarse
from tests.support.trust import accept, carry, share

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]
LABEL: Final = "remote/hospital"
PAIRS: Final = tuple(itertools.product(KINDS, KINDS))
pairs = pytest.mark.parametrize(
    ("source", "sink"), PAIRS, ids=[f"{source}-to-{sink}" for source, sink in PAIRS]
)


@dataclass(frozen=True)
class Cast:
    """Both sides, and the programs of the home that listen."""

    home: World
    hospital: World
    listeners: Mapping[str, Running]

    def tool(self, *words: str) -> str:
        """The output of a stock tool of the home."""
        return self.home.tool(*words, options=("--as", "/tool"))


def world(directory: Path, domain: str) -> World:
    loopback = Host((), "127.0.0.1", "::1")
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
            (Right.SUBSCRIBE, "/*/words"), (Right.SUBSCRIBE, "/*/latched"),
            (Right.CALL, "/*/switch"),
        ):  # fmt: skip
            share(hospital.site, home.site, listener, right, pattern)
        share(hospital.site, home.site, listener, Right.SUBSCRIBE, "/*/pose", coarse())
    home.enroll("/tool", graph="/**", publish="/**", param_set="/**", provide="/**")
    for right in (Right.SUBSCRIBE, Right.CALL, Right.GRAPH):
        share(hospital.site, home.site, "/tool", right, "/**")
    home.site.enroll("/master")
    share(hospital.site, home.site, "/master", Right.GRAPH, "/**")
    for side in (home, hospital):
        side.site.enroll("/master")
        carry(side.site)


@pytest.fixture(scope="module")
def cast(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cast]:
    directory = tmp_path_factory.mktemp("foreign")
    home, hospital = world(directory, "home"), world(directory, "hospital")
    prepare(home, hospital)
    config = directory / "master.yaml"
    config.write_text(
        "federation:\n  sites:\n"
        f"    hospital: {{uri: 'http://127.0.0.1:{hospital.port}', domain: hospital}}\n"
    )
    with contextlib.ExitStack() as stack:
        stack.enter_context(hospital.master())
        stack.enter_context(home.master("--config", str(config)))

        def start(side: World, kind: str, source: str, *more: str) -> Running:
            line = command(kind, sys.executable, ROSSEC, source, *more)
            return stack.enter_context(side.started(side.hosts.near, *line))

        speakers = [start(hospital, kind, SPEAKERS[kind]) for kind in KINDS]
        for speaker in speakers:
            speaker.wait_for("READY")
        told = " ".join(f"{LABEL}/{kind}" for kind in KINDS), str(directory / "never")
        listeners = {kind: start(home, kind, LISTENERS[kind], *told) for kind in KINDS}
        yield Cast(home, hospital, listeners)


@pairs
def test_foreign_messages_arrive_at_every_form(cast: Cast, source: str, sink: str) -> None:
    listener = cast.listeners[sink]
    listener.wait_for(f"HEARD {LABEL}/{source} words {source} ")
    listener.wait_for(f"HEARD {LABEL}/{source} latched {source} kept")


@pairs
def test_foreign_publishers_filter(cast: Cast, source: str, sink: str) -> None:
    about = f"HEARD {LABEL}/{source} pose "
    listener = cast.listeners[sink]
    wait(lambda: listener.said.count(about) > 3)
    poses = {line.removeprefix(about).strip() for line in listener.lines if line.startswith(about)}
    assert poses == {SEEN}


@pairs
def test_foreign_services_are_called(cast: Cast, source: str, sink: str) -> None:
    for about in ("CALLED", "KEPT"):
        cast.listeners[sink].wait_for(f"{about} {LABEL}/{source} {source} answers")
