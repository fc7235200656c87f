"""The list of domains at a master that runs: taken from the commands, and enforced."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from ca.domains import DomainList, open_domains
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.cli.domain import publish_domains
from rossec.cli.shared.context import Environment
from rossec.cli.shared.service import call_master
from rossec.home import NodeHome
from rossec.master.server.server import MasterServer, master_of
from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Said, Shell


@asynccontextmanager
async def running_master(shell: Shell) -> AsyncIterator[MasterServer]:
    shell.enroll("/master")
    home = NodeHome.of(shell.root, "/master")
    newest = AuthorityHome.at(shell.root).revocation_list()
    master = master_of(home, host="127.0.0.1", port=0, newest=newest, now=int(time.time()))
    await master.start()
    try:
        yield master
    finally:
        await master.close()


async def list_at(master: MasterServer, sites: Neighbours) -> DomainList:
    """The list that the master has."""
    call = StatementCall(sites.home.node(), "rossec.domains", (b"",), "a query", "")
    data = await asyncio.to_thread(call_master, Environment(sites.shell.environ), master.uri, call)
    assert isinstance(data, bytes)
    return open_domains(data, sites.home.anchor())


async def test_each_change_reaches_the_master(sites: Neighbours) -> None:
    async with running_master(sites.shell) as master:
        to = ("--master", master.uri)

        async def run(*arguments: str) -> Said:
            return await asyncio.to_thread(sites.shell.unlocked, *arguments, *to)

        said = await run("domain", "accept", str(sites.bundle), "--yes")
        assert said.code == 0, said
        assert said.out.endswith("the master has the new list of domains\n")
        assert [each.label for each in (await list_at(master, sites)).domains] == ["hospital"]
        assert (await run("domain", "limit", "hospital", "--fresh", "60s", "--yes")).code == 0
        assert [each.fresh for each in (await list_at(master, sites)).domains] == [60]
        assert (await run("domain", "remove", "hospital")).code == 0
        assert (await list_at(master, sites)).domains == ()
        assert (await run("ca", "refresh")).code == 0
        assert (await list_at(master, sites)).seq == 4
        assert (await run("ca", "publish")).code == 0


async def test_the_key_of_a_second_master_reaches_the_first(sites: Neighbours) -> None:
    async with running_master(sites.shell) as master:
        assert sites.shell("node", "request", "/master/kitchen").code == 0
        request = str(sites.shell.node("/master/kitchen") / "node.csr")
        sign = ("ca", "sign", request, "--yes", "--master", master.uri)
        said = await asyncio.to_thread(sites.shell.unlocked, *sign)
        assert "the master has the new list of domains, with the keys of all masters" in said.out
        assert len((await list_at(master, sites)).masters) == 2


def test_a_second_master_is_enrolled_while_the_first_is_off(sites: Neighbours) -> None:
    sites.shell.enroll("/master")
    sites.shell("node", "request", "/master/kitchen")
    request = str(sites.shell.node("/master/kitchen") / "node.csr")
    said = sites.shell.unlocked("ca", "sign", request, "--yes", "--master", "http://127.0.0.1:1")
    assert said.code == 0
    assert "did not take the list of domains" in said.err
    assert "rossec ca publish" in said.err
    assert len(sites.listed().masters) == 2


def test_what_was_signed_is_delivered_and_said(sites: Neighbours) -> None:
    sites.accept()
    calls: list[StatementCall] = []
    publish_domains(AuthorityService(sites.shell.root, str, calls.append))
    assert [call.method for call in calls] == ["rossec.updateDomains"]
