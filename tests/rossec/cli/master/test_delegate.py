"""`rossec master delegate`: a running master renews, until what was delegated is withdrawn."""

import asyncio
import time
from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from rossec.master.server.server import master_of
from tests.support.commands import Shell, refused

NOBODY = ("--master", "http://127.0.0.1:1")


@pytest.fixture
def site(tmp_path: Path, shell: Shell) -> Shell:
    shell.enroll("/master")
    return shell


async def test_a_delegation_is_delivered_to_the_running_master(site: Shell) -> None:
    home = NodeHome.of(site.root, "/master")
    newest = AuthorityHome.at(site.root).revocation_list()
    server = master_of(home, host="127.0.0.1", port=0, newest=newest, now=int(time.time()))
    await server.start()
    try:
        command = ("master", "delegate", "--ticket", "1h", "--master", server.uri)
        said = await asyncio.to_thread(site.unlocked, *command)
        assert said.code == 0, said
        assert said.out.startswith("/master may renew grants until ")
        assert said.out.endswith("the master has the delegation\n")
        delegation = home.load_delegation()
        assert delegation is not None
        [kept] = (site.root / "ca" / "delegations").glob("*.cose")
        assert kept.read_bytes() == delegation
        said = await asyncio.to_thread(site.unlocked, *command, "--withdraw")
        assert said.out == "withdrew 1 delegation (list 2)\nthe master has the new list\n"
    finally:
        await server.close()


def test_a_master_with_another_key_starts_and_says_so(site: Shell, caplog: pytest.LogCaptureFixture) -> None:
    home = NodeHome.of(site.root, "/master")
    home.save_delegation(b"garbage")
    master_of(home, host="127.0.0.1", port=0, newest=None, now=int(time.time()))
    assert "grants are not renewed: " in caplog.text


def test_no_master_to_tell(site: Shell) -> None:
    said = site.unlocked("master", "delegate", *NOBODY)
    refused(said, "did not take it", "it is signed and stored in", code=3)


def test_nothing_to_withdraw_and_too_long(site: Shell) -> None:
    refused(site.unlocked("master", "delegate", "--withdraw", *NOBODY), "no delegation is in force")
    said = site.unlocked("master", "delegate", "--for", "91d", *NOBODY)
    refused(said, "at most 90d are allowed", code=2)
    said = site.unlocked("master", "delegate", "--ticket", "8d", *NOBODY)
    refused(said, "at most 7d are allowed", code=2)
    said = site.unlocked("master", "delegate", "--ticket", "59s", *NOBODY)
    refused(said, "a ticket of 59 s ends before a node can", "give 60s or more")
    assert not (site.root / "ca" / "delegations").exists()


async def test_a_tree_is_delivered_with_its_entries(site: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    home = NodeHome.of(site.root, "/master")
    server = master_of(home, host="127.0.0.1", port=0, newest=None, now=int(time.time()))
    await server.start()
    try:
        site.enroll("/robot")
        command = ("ca", "revoke", "/robot", "--master", server.uri)
        said = await asyncio.to_thread(site.unlocked, *command)
        assert said.out.endswith("the master has the new list\n"), said
        assert home.load_entries() == AuthorityHome.at(site.root).newest_statement()[1]
    finally:
        await server.close()


def test_a_master_begins_with_the_tree_it_had(
    site: Shell, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    site.enroll("/robot")
    site.unlocked("ca", "revoke", "/robot", *NOBODY)
    home, authority = NodeHome.of(site.root, "/master"), AuthorityHome.at(site.root)

    def begin(newest: bytes | None, entries: bytes | None) -> None:
        caplog.clear()
        master_of(home, host="127.0.0.1", port=0, newest=newest, entries=entries, now=int(time.time()))

    begin(authority.revocation_list(), None)
    assert "the entries of the revocation tree are missing" in caplog.text
    begin(authority.revocation_list(), authority.newest_statement()[1])
    assert caplog.text == ""
    begin(None, None)  # it has kept both
    assert caplog.text == ""


async def test_another_master_of_the_domain_has_its_own_delegation(site: Shell) -> None:
    await asyncio.to_thread(site.enroll, "/master/kitchen")
    home = NodeHome.of(site.root, "/master/kitchen")
    newest = AuthorityHome.at(site.root).revocation_list()
    server = master_of(home, host="127.0.0.1", port=0, newest=newest, now=int(time.time()))
    await server.start()
    try:
        to = ("--to", "/master/kitchen", "--master", server.uri)
        said = await asyncio.to_thread(site.unlocked, "master", "delegate", *to)
        assert said.out.startswith("/master/kitchen may renew grants until "), said
        assert home.load_delegation() is not None
    finally:
        await server.close()
    said = await asyncio.to_thread(site.unlocked, "master", "delegate", "--to", "/robot", *NOBODY)
    refused(said, "not the name of a master")
