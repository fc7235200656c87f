"""Masters of several domains on hosts of their own, as processes, with nodes beside each of them.

`Mesh` has the network (`tests.support.lan`), `Place` is one host: a master, and the crew of nodes
that use it. Homes of a domain are in one directory, as if it were on every host; the authority's
record is outside of it, so that lists reach a master only over the network.
"""

import asyncio
import base64
import contextlib
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest

from ca.domains import open_domains, sign_domains
from grants.model import Right
from rossec.federation.settings import SiteFile, SiteSettings
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from tests.support.crewprocess import CrewProcess
from tests.support.hosts import Host
from tests.support.lan import Lan, lan_of
from tests.support.site import Site
from tests.support.trust import share
from tests.support.witness import until

PORT: Final = 11311
_SHORTENED: Final = """
from rossec.federation import follower, site_state
follower.SILENCE = 5.5
site_state.LOST_FOR = 1
site_state.LONGEST_PAUSE = 2
from rossec.cli.main import main
main()
"""
OBSERVER: Final = "/observer"  # may see everything at its master


class Domain:
    """One trust domain with its masters."""

    def __init__(self, root: Path, name: str) -> None:
        self.name = name
        self.site = Site(root, name)

    def enroll(self, name: str, **rights: str) -> None:
        """Enroll a node with rights on names of this domain: `publish="/a /b"`."""
        self.site.enroll(name)
        for right, patterns in rights.items():
            for pattern in patterns.split():
                self.site.grant(name, Right[right.upper()], pattern)

    def invite(self, other: "Domain", name: str, **rights: str) -> None:
        """Give a node of `other` rights on names of this domain; it has the grants at once."""
        for right, patterns in rights.items():
            for pattern in patterns.split():
                share(self.site, other.site, name, Right[right.upper()], pattern)

    def list_for(self, seconds: int) -> bytes:
        """The newest list of domains, but one that expires so soon; `trust.newest` follows it."""
        newest = open_domains(self.site.authority.store.domains.newest_list(), self.site.anchor)
        epoch, seq = newest.number
        now = self.site.now()
        brief = replace(newest, seq=seq + 1, issued=now, expires=now + seconds)
        data = sign_domains(self.site.authority.signer, brief, self.name)
        self.site.authority.store.domains.save_list((epoch, seq + 1), data, now)
        return data


class Place:
    """A host of a domain with a master, and the nodes that use it."""

    def __init__(self, domain: Domain, name: str, host: Host, master: str) -> None:
        self.domain, self.name, self.host, self.master = domain, name, host, master
        self.directory = domain.site.root.parent / name
        self.directory.mkdir(mode=0o700)
        self.log = self.directory / "master.log"
        self._process: asyncio.subprocess.Process | None = None
        self._crew: CrewProcess | None = None
        self._module: tuple[str, ...] = ("-m", "rossec")
        self._options: tuple[str, ...] = ()

    @property
    def uri(self) -> str:
        return f"http://{self.host.ipv4}:{PORT}/"

    @property
    def environ(self) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        return {
            **kept,
            "ROSSEC_HOME": str(self.domain.site.root),
            "ROS_IP": self.host.ipv4,
            "ROS_MASTER_URI": self.uri,
            "ROSSEC_MASTER": self.master,
            "PYTHONUNBUFFERED": "1",
        }

    @property
    def crew(self) -> CrewProcess:
        """The nodes of this host."""
        assert self._crew is not None
        return self._crew

    def rossec(self, *words: str) -> tuple[str, ...]:
        """A command on this host."""
        return self.host.at(sys.executable, "-m", "rossec", *words)

    async def run(self, *words: str) -> str:
        """Run `rossec WORDS` on this host; what it printed."""
        process = await asyncio.create_subprocess_exec(
            *self.rossec(*words),
            env=self.environ,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        async with asyncio.timeout(40):
            said, _ = await process.communicate()
        assert process.returncode == 0, said.decode()
        return said.decode()

    async def begin(self, *options: str, shortened: bool = False) -> None:
        """Start the master and the crew, and wait until the master answers.

        `shortened`: it forgets a silent site sooner, also when it is started again.
        """
        self._module = ("-c", _SHORTENED) if shortened else ("-m", "rossec")
        self._options = options
        await self.start()
        if self._crew is None:
            self._crew = await CrewProcess.started(
                self.host.prefix, self.environ, self.directory / "crew.log"
            )

    def follow(self, other: "Place", domain: str = "") -> None:
        """Have this master follow another one, which is of the foreign domain with this label."""
        label = domain or other.name
        site = SiteSettings(label, other.uri, other.master, domain)
        self._file.change(lambda sites: sites.update({label: site}))

    def unfollow(self, label: str) -> None:
        """Have this master follow a site no longer."""
        self._file.change(lambda sites: sites.__delitem__(label))

    @property
    def _file(self) -> SiteFile:
        return SiteFile(NodeHome.of(self.domain.site.root, self.master).path)

    async def start(self) -> None:
        """Start the master as before, and wait until it answers."""
        name = () if self.master == MASTER else ("--name", self.master)
        before = self.said().count(self.uri)
        with self.log.open("ab") as log:
            self._process = await asyncio.create_subprocess_exec(
                *self.host.at(sys.executable, *self._module, "master", *name, *self._options),
                env=self.environ,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        process = self._process

        def up() -> bool:
            assert process.returncode is None, self.said()
            return self.said().count(self.uri) > before

        await until(up, within=40)

    def said(self) -> str:
        """What the master has printed and logged."""
        return self.log.read_text() if self.log.exists() else ""

    def audit(self) -> str:
        """The master's audit."""
        return (NodeHome.of(self.domain.site.root, self.master).path / "audit.log").read_text()

    async def kill(self) -> None:
        """End the master as `kill -9` does."""
        assert self._process is not None
        self._process.kill()
        await self._process.wait()

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """The master is stopped meanwhile, as a suspended machine."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)

    async def see(self, method: str = "getSystemState", *params: object) -> object:
        """An answer of this place's master to one who may see all."""
        return await self.crew.do(OBSERVER, "ask", method, *params)

    async def deliver(self, method: str, data: bytes) -> object:
        """Give a signed list to this place's master, as its authority would."""
        return await self.crew.do(OBSERVER, "deliver", method, base64.b64encode(data).decode())

    async def sites(self) -> dict[str, dict[str, Any]]:
        """The sites that this master follows, by label."""
        said = json.loads(await self.run("federation", "status", "--json"))
        return {site["label"]: site for site in said["sites"]}

    async def close(self) -> None:
        """Kill everything of this host."""
        if self._crew is not None:
            await self._crew.close()
        if self._process is not None and self._process.returncode is None:
            await self.kill()


class Mesh:
    """The network, its domains and places."""

    def __init__(self, lan: Lan, root: Path) -> None:
        self.lan, self.root = lan, root
        self.domains: dict[str, Domain] = {}
        self.places: dict[str, Place] = {}

    def add(self, domain: str, *hosts: str) -> Domain:
        """A domain with a master on each host: `/master` on the first, `/master/HOST` elsewhere."""
        added = self.domains[domain] = Domain(self.root / f"{domain}.homes", domain)
        added.enroll(OBSERVER, graph="/**")
        for number, host in enumerate(hosts):
            master = f"{MASTER}/{host}" if number else MASTER
            home = added.site.enroll(master)
            home.save_revocations(added.site.authority.store.newest_list() or b"")
            self.places[host] = Place(added, host, self.lan[host], master)
        return added

    def __getitem__(self, host: str) -> Place:
        return self.places[host]

    async def close(self) -> None:
        for place in self.places.values():
            await place.close()


@contextlib.asynccontextmanager
async def mesh_of(segments: Mapping[str, Sequence[str]], root: Path) -> AsyncIterator[Mesh]:
    """A domain for each segment of the network; nothing runs yet."""
    with lan_of(segments) as lan:
        if not lan.real:
            pytest.skip("needs network namespaces")
        mesh = Mesh(lan, root)
        for domain, hosts in segments.items():
            mesh.add(domain, *hosts)
        try:
            yield mesh
        finally:
            await mesh.close()
