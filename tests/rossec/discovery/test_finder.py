"""Finding a master on real links: two hosts, real programs."""

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.revocation.tree import is_tree
from rossec.discovery import announcer, choose, finder, multicast
from rossec.discovery.candidates import Candidates, DatagramSource
from rossec.errors import AnnouncementRefused, ConfigurationError, MasterNotFound
from tests.rossec.discovery.conftest import Make
from tests.support.hosts import Host, Hosts, two_hosts
from tests.support.site import Site
from tests.support.witness import until

ROSSEC = (sys.executable, "-m", "rossec")


@pytest.fixture(scope="module")
def hosts() -> Iterator[Hosts]:
    with two_hosts() as made:
        if not made.real:
            pytest.skip("NOT RUN: network namespaces are not permitted here")
        yield made


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Site:
    site = Site(tmp_path_factory.mktemp("finding") / "home")
    for name in ("/master", "/robot"):
        site.enroll(name)
    return site


def run(site: Site, host: Host, *words: str, **environ: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "ROSSEC_HOME": str(site.root), **environ}
    command = host.at(*ROSSEC, *words)
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture(scope="module")
def master(hosts: Hosts, home: Site) -> Iterator[subprocess.Popen[str]]:
    env = {**os.environ, "ROSSEC_HOME": str(home.root), "ROS_IP": hosts.near.ipv4}
    command = hosts.near.at(*ROSSEC, "master", "--port", "0", "--json", "--announce")
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline().startswith('{"ready"')
        yield running
        running.send_signal(signal.SIGTERM)
        assert running.wait(20) == 0


def test_a_master_is_found_without_configuration(
    hosts: Hosts, home: Site, master: subprocess.Popen[str]
) -> None:
    done = run(home, hosts.far, "discover", "--as", "/robot", "--json")
    assert done.returncode == 0, done.stderr
    (row,) = [json.loads(line) for line in done.stdout.splitlines()]
    assert row["uri"].startswith("http://10.99.0.1:")
    assert row["link"] == "rossec0"
    assert row["key"] == home.identity("/master").thumbprint.hex()
    people = run(home, hosts.far, "discover").stdout
    assert people.startswith(row["uri"])
    assert re.search(r"ms, [0-9]+% of [0-9]+ lost, heard [0-9.]+ s ago, on rossec0", people)
    assert row["heard"] >= 2
    assert row["heard"] <= row["sent"]
    assert row["age_s"] < 15


def test_a_program_is_started_with_the_master_that_was_found(
    hosts: Hosts, home: Site, master: subprocess.Popen[str]
) -> None:
    code = (
        "import asyncio, os; from rossec.discovery.choose import discover_master;"
        "print(asyncio.run(discover_master(os.environ, '/robot'))['ROS_MASTER_URI'])"
    )
    env = {**os.environ, "ROSSEC_HOME": str(home.root), "ROS_MASTER_URI": "discover:"}
    command = hosts.far.at(sys.executable, "-c", code)
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.startswith("http://10.99.0.1:")


def test_another_domains_master_is_not_found(
    hosts: Hosts, elsewhere: Site, master: subprocess.Popen[str]
) -> None:
    done = run(elsewhere, hosts.far, "discover", "--seconds", "3")
    assert done.returncode == 1
    assert "no master of this trust domain was found, but" in done.stderr
    assert "not signed by the authority of trust domain" in done.stderr
    assert "Traceback" not in done.stderr


def test_no_announcement_is_an_error(hosts: Hosts, home: Site) -> None:
    with two_hosts() as quiet:
        done = run(home, quiet.far, "discover", "--seconds", "0.3")
    assert done.returncode == 1
    assert "no master announces itself" in done.stderr
    assert "rossec master --announce" in done.stderr


def test_a_master_on_loopback_is_not_announced(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    newest = site.authority.store.newest_list()
    assert newest is not None
    site.enroll("/master").save_revocations(newest)
    here = Host((), "127.0.0.1", "::1")
    done = run(site, here, "master", "--port", "0", "--announce", ROS_IP="127.0.0.1")
    assert done.returncode == 1
    assert "only this host reaches it" in done.stderr


# --- the same shells on an imagined link


class Link(multicast.MulticastSocket):
    """A group of which this process is the only member."""

    takes = 1

    def __init__(self, *, listen: bool) -> None:
        super().__init__(listen=listen)
        self.inner, self.outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.inner.setblocking(False)
        links.append(self)

    def fileno(self) -> int:
        return self.inner.fileno()

    def send(self, data: bytes) -> int:
        said.append(data)
        return self.takes

    def receive(self) -> Iterator[tuple[bytes, DatagramSource]]:
        yield self.inner.recv(2048), DatagramSource("127.0.0.1", 1)

    def close(self) -> None:
        super().close()
        self.inner.close()
        self.outer.close()


links: list[Link] = []
said: list[bytes] = []


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> None:
    links.clear()
    said.clear()
    for module in (finder, announcer):
        monkeypatch.setattr(module, "MulticastSocket", Link)


async def receive(data: bytes) -> None:
    await until(lambda: links)
    links[-1].outer.send(data)


@pytest.mark.usefixtures("link")
async def test_a_master_that_answers_is_chosen(site: Site, make: Make) -> None:
    server = await asyncio.start_server(lambda _, writer: writer.close(), "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with asyncio.TaskGroup() as group:
        finding = group.create_task(finder.find(site.anchor, settle=0.2))
        await receive(b"garbage")
        await receive(make(host="nowhere.invalid", port=port, issued=int(time.time())))
    (found,) = finding.result()
    assert choose.uri_of(found) == f"http://127.0.0.1:{port}"
    server.close()
    await server.wait_closed()


@pytest.mark.usefixtures("link")
async def test_a_master_behind_a_firewall(site: Site, make: Make) -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    async with asyncio.TaskGroup() as group:
        finding = group.create_task(_refused(site))
        await receive(make(host="127.0.0.1", port=port, issued=int(time.time())))
    assert "a master announces itself, but nothing answers at 127.0.0.1 port" in finding.result()


async def _refused(site: Site) -> str:
    with pytest.raises(MasterNotFound) as caught:
        await finder.find(site.anchor, patience=1.0)
    return str(caught.value)


@pytest.mark.usefixtures("link")
async def test_announcements_are_counted_and_survive_links_that_go_down(
    home: Site, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("WARNING")
    monkeypatch.setattr(Link, "takes", 0)
    credentials = home.enroll("/master").credentials()
    uri = "http://192.0.2.7:11311/"
    speaking = asyncio.ensure_future(announcer.announce(credentials, uri, period=0.01))
    await until(lambda: said)
    Link.takes = 1
    await until(lambda: len(said) > 3)
    speaking.cancel()
    assert ["no link" in caplog.text, "the links again" in caplog.text] == [True, True]
    candidates, now = Candidates(home.anchor), int(time.time())
    for data in said[:3]:
        heard = candidates.heard(data, DatagramSource("fe80::1", 1), now, 1.0)
        assert heard is not None
    with pytest.raises(AnnouncementRefused):
        candidates.heard(said[0][:-1], DatagramSource("fe80::1", 1), now, 1.0)


def test_a_routed_datagram_is_dropped() -> None:
    def ancillary(hops: int) -> list[tuple[int, int, bytes]]:
        value = hops.to_bytes(4, sys.byteorder)
        return [(socket.IPPROTO_IPV6, socket.IPV6_HOPLIMIT, value)]

    assert multicast._is_local("fe80::1", ancillary(255))
    assert multicast._is_local("fe80::1%lo", ancillary(255))
    assert not multicast._is_local("fe80::1", ancillary(254))
    assert not multicast._is_local("2001:db8::1", ancillary(255))
    assert not multicast._is_local("fe80::1", [])


# --- whom a home trusts


def test_a_damaged_authority_is_named_by_its_file(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/robot")
    file = site.enroll("/odd").path / "ca.pem"
    for damaged in (b"garbage", 2 * file.read_bytes()):
        file.write_bytes(damaged)
        with pytest.raises(ConfigurationError, match=r"nodes/odd/ca\.pem: ") as refused:
            choose.trusted(site.root, None)
        assert "anew" in refused.value.hint


def test_the_trust_anchor_decides_the_master(home: Site, elsewhere: Site, tmp_path: Path) -> None:
    assert choose.trusted(home.root, None)[0].thumbprint == home.anchor.thumbprint
    assert choose.trusted(home.root, "/robot")[1] == frozenset()
    with pytest.raises(ConfigurationError, match="no node is enrolled"):
        choose.trusted(tmp_path, None)
    for part in ("ca.pem", "node.pem"):
        target = home.root / "nodes" / "stray" / part
        target.parent.mkdir(exist_ok=True)
        target.write_bytes((elsewhere.root / "nodes" / "master" / part).read_bytes())
    with pytest.raises(ConfigurationError, match="different authorities"):
        choose.trusted(home.root, None)
    for part in ("ca.pem", "node.pem"):
        (home.root / "nodes" / "stray" / part).unlink()


def test_what_is_known_to_be_revoked_counts(home: Site) -> None:
    newest = home.authority.store.newest_list()
    assert newest is not None
    robot = home.enroll("/robot")
    home.revoke(home.identity("/master").thumbprint)
    newest = home.authority.store.newest_list()
    assert newest is not None
    robot.save_revocations(newest)
    assert home.identity("/master").thumbprint in choose.trusted(home.root, "/robot")[1]


def test_a_tree_of_revocations_leaves_it_to_the_handshake(
    elsewhere: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    robot = elsewhere.enroll("/robot")
    elsewhere.revoke(elsewhere.identity("/master").thumbprint)
    newest = elsewhere.authority.store.newest_list()
    assert newest is not None
    assert is_tree(newest)
    robot.save_revocations(newest)
    assert choose.trusted(elsewhere.root, "/robot")[1] == frozenset()


def test_an_error_of_the_socket_ends_receiving() -> None:
    group = multicast.MulticastSocket(listen=False)
    group.close()
    assert list(group.receive()) == []


async def test_a_uri_that_is_set_is_kept(home: Site) -> None:
    environ = {"ROS_MASTER_URI": "http://robot:11311"}
    assert await choose.discover_master(environ, None) == environ
