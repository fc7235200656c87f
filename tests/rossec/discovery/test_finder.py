"""Finding a master on real links: two hosts, real programs."""

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from rossec.discovery import local_links
from rossec.errors import MasterNotFound
from tests.rossec.discovery.conftest import Make
from tests.rossec.discovery.links import receive
from tests.support.hosts import Host, Hosts, two_hosts
from tests.support.ports import free_port
from tests.support.site import Site

ROSSEC = (sys.executable, "-m", "rossec")


@pytest.fixture(scope="module")
def hosts() -> Iterator[Hosts]:
    with two_hosts() as made:
        if not made.real:
            pytest.skip("NOT RUN: network namespaces are not permitted here")
        yield made


def run(site: Site, host: Host, *words: str, **environ: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "ROSSEC_HOME": str(site.root), **environ}
    command = host.at(*ROSSEC, *words)
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture(scope="module")
def master(hosts: Hosts, home: Site) -> Iterator[subprocess.Popen[str]]:
    newest = home.authority.store.newest_list()
    assert newest is not None
    home.enroll("/master").save_revocations(newest)
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
        "import asyncio, os; from rossec.discovery.local_links import discover_master;"
        "print(asyncio.run(discover_master(os.environ, '/robot'))['ROS_MASTER_URI'])"
    )
    env = {**os.environ, "ROSSEC_HOME": str(home.root), "ROS_MASTER_URI": "discover:"}
    command = hosts.far.at(sys.executable, "-c", code)
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.startswith("http://10.99.0.1:")


def test_commands_find_the_master(hosts: Hosts, home: Site, master: subprocess.Popen[str]) -> None:
    discover = {"ROS_MASTER_URI": "discover:", "ROS_IP": hosts.far.ipv4}
    home.publish("/robot", "/x")
    checked = run(home, hosts.far, "doctor", "/robot", **discover)
    assert "ok      the clock agrees with the master's" in checked.stdout
    assert "ok      the master at http://10.99.0.1:" in checked.stdout
    assert checked.returncode == 0, checked.stderr
    for words in (("topic", "list"), ("node", "list"), ("param", "list"), ("service", "list")):
        done = run(home, hosts.far, *words, "--as", "/robot", **discover)
        assert done.returncode == 0, done.stderr


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


@pytest.mark.usefixtures("link")
async def test_a_master_that_answers_is_chosen(site: Site, make: Make) -> None:
    server = await asyncio.start_server(lambda _, writer: writer.close(), "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with asyncio.TaskGroup() as group:
        finding = group.create_task(local_links.find(site.anchor, settle=0.2))
        await receive(b"garbage")
        await receive(make(host="nowhere.invalid", port=port, issued=int(time.time())))
    (found,) = finding.result()
    assert local_links.uri_of(found) == f"http://127.0.0.1:{port}"
    server.close()
    await server.wait_closed()


@pytest.mark.usefixtures("link")
async def test_a_master_behind_a_firewall(site: Site, make: Make) -> None:
    port = free_port()
    async with asyncio.TaskGroup() as group:
        finding = group.create_task(_refused(site))
        await receive(make(host="127.0.0.1", port=port, issued=int(time.time())))
    assert "a master announces itself, but nothing answers at 127.0.0.1 port" in finding.result()


async def _refused(site: Site) -> str:
    with pytest.raises(MasterNotFound) as caught:
        await local_links.find(site.anchor, patience=1.0)
    return str(caught.value)
