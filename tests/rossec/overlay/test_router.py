"""Routers with accounts, in this process, and carriers that use them."""

import asyncio
import logging
import socket
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from rossec.errors import ConfigurationError, OverlayUnavailable
from rossec.overlay import router as router_module
from rossec.overlay.documents import Routers
from rossec.overlay.endpoint import LinkListener, dial_link
from rossec.overlay.homes import RouterHome
from rossec.overlay.router import Router, accounts_of
from rossec.overlay.zenoh_carrier import Carrier
from tests.support.contexts import context
from tests.support.overlay import until
from tests.support.routerprocess import PASSWORD, home_with
from tests.support.secure_streams import echo
from tests.support.wire import ALICE, BOB

HOME = "rossec/1/home/00112233445566778899aabbccddeeff"
CLINIC = "rossec/1/clinic/ffeeddccbbaa99887766554433221100"


@asynccontextmanager
async def started(home: RouterHome, *, is_open: bool = False) -> AsyncIterator[Router]:
    router = Router(home, home.settings(), is_open=is_open)
    await router.start()
    watching = asyncio.ensure_future(router.run())
    try:
        yield router
    finally:
        watching.cancel()
        await router.close()


@asynccontextmanager
async def seated(routers: Routers) -> AsyncIterator[Carrier]:
    opened = await Carrier.open(routers)
    try:
        yield opened
    finally:
        await opened.close()


async def arrives(sender: Carrier, receiver: Carrier, key: str) -> None:
    got: list[bytes] = []
    subscription = receiver.subscribe(key, got.append)

    def put() -> object:
        sender.put(key, b"ping")
        return got

    await until(put)
    subscription.close()


@pytest.mark.parametrize("protocol", ["quic", "tcp", "tls"])
async def test_accounts_reach_each_other(tmp_path: Path, protocol: str) -> None:
    home = home_with(tmp_path / "a", "home", "clinic", protocol=protocol)
    async with (
        started(home),
        seated(home.account_file("home")) as alice,
        seated(home.account_file("clinic")) as bob,
    ):
        await arrives(alice, bob, CLINIC)
        await arrives(bob, alice, HOME)


async def test_routers_of_one_operator_forward_for_each_other(tmp_path: Path) -> None:
    one = home_with(tmp_path / "a", "home", "clinic")
    two = home_with(tmp_path / "b", protocol="quic")
    (two.path / "authority.key").unlink()
    two.take(one.share())
    async with started(two) as later, started(one):  # the one that is joined begins later
        await until(lambda: later.joined == 1)
        at_two = Routers(two.settings().listen, *_secrets(two))
        async with seated(one.account_file("clinic")) as bob, seated(at_two) as alice:
            await arrives(alice, bob, CLINIC)
            await arrives(bob, alice, HOME)


async def test_a_router_that_comes_back_is_joined_again(tmp_path: Path) -> None:
    one = home_with(tmp_path / "a", protocol="tcp")
    two = home_with(tmp_path / "b", protocol="tcp", join=one.settings().listen)
    async with started(two, is_open=True) as later:
        for _ in range(2):
            async with started(one, is_open=True):
                await until(lambda: later.joined == 1)
            await until(lambda: later.joined == 0)


def _secrets(home: RouterHome) -> tuple[str, str, str]:
    found = home.account_file("home")
    return found.account, found.password, found.root_certificate


async def test_an_account_is_taken_over_and_given_up_while_it_runs(tmp_path: Path) -> None:
    home = home_with(tmp_path / "a", "home")
    async with started(home), seated(home.account_file("home")) as alice:
        home.change_accounts(lambda found: found.add("clinic", PASSWORD))
        clinic = home.account_file("clinic")
        async with _seated_soon(clinic) as bob:
            await arrives(bob, alice, HOME)
            await arrives(alice, bob, CLINIC)
            home.change_accounts(lambda found: found.remove("clinic"))
            await until(lambda: not bob.router)
            await until(lambda: alice.router)
            with pytest.raises(OverlayUnavailable, match="no router takes the account clinic"):
                await Carrier.open(clinic)


async def test_a_link_goes_on_while_accounts_change(tmp_path: Path) -> None:
    home = home_with(tmp_path / "a", "home", "clinic")
    async with (
        started(home),
        seated(home.account_file("home")) as alice,
        seated(home.account_file("clinic")) as bob,
        LinkListener(bob, CLINIC, context(BOB), echo),
        await dial_link(alice, CLINIC, "home", context(ALICE)) as stream,
    ):
        before = home.accounts_version()
        home.change_accounts(lambda found: found.add("third", PASSWORD))
        assert home.accounts_version() != before
        third = asyncio.ensure_future(_is_seated(home.account_file("third")))
        count = 0
        while not third.done() or not alice.router:
            await stream.send(count.to_bytes(4))
            assert await stream.receive() == count.to_bytes(4)
            count += 1
        await third
        await stream.send(b"still")
        assert await stream.receive() == b"still"


async def _is_seated(routers: Routers) -> None:
    async with _seated_soon(routers):
        pass


async def test_the_last_account_is_given_up_while_it_runs(tmp_path: Path) -> None:
    home = home_with(tmp_path / "a", "home")
    routers = home.account_file("home")
    async with started(home), seated(routers) as alice:
        home.change_accounts(lambda found: found.remove("home"))
        await until(lambda: not alice.router)
        with pytest.raises(OverlayUnavailable, match="no router takes the account home"):
            await Carrier.open(routers)


async def test_an_open_router_stays_open_until_it_is_told_otherwise(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    home = home_with(tmp_path / "a", protocol="tcp")
    async with started(home, is_open=True):
        home.change_accounts(lambda found: found.add("home", PASSWORD))
        await until(lambda: "so it is not open" in caplog.text)
        async with seated(home.account_file("open")) as alice:
            assert alice.router


async def test_a_session_that_does_not_end_keeps_no_router_from_ending(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck = threading.Event()
    session = SimpleNamespace(close=stuck.wait, info=None)
    monkeypatch.setattr(router_module, "open_session", lambda _: session)
    monkeypatch.setattr(router_module, "CLOSING", 0.1)
    home = home_with(tmp_path / "a", "home")
    router = Router(home, home.settings(), is_open=False)
    await router.start()
    await router.close()
    assert router.joined == 0
    stuck.set()


@asynccontextmanager
async def _seated_soon(routers: Routers) -> AsyncIterator[Carrier]:
    opened: list[Carrier] = []
    async with asyncio.timeout(20):
        while not opened:
            try:
                opened.append(await Carrier.open(routers))
            except OverlayUnavailable:
                await asyncio.sleep(0.05)
    try:
        yield opened[0]
    finally:
        await opened[0].close()


async def test_a_damaged_list_of_accounts_is_not_taken_over(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    home = home_with(tmp_path / "a", "home", "clinic")
    routers = home.account_file("home"), home.account_file("clinic")
    async with started(home), seated(routers[0]) as alice, seated(routers[1]) as bob:
        (home.path / "accounts.json").write_bytes(b"damaged")
        await until(lambda: "is not taken over" in caplog.text)
        await arrives(alice, bob, CLINIC)


async def test_it_is_said_how_many_routers_are_joined(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    one = home_with(tmp_path / "a", protocol="tcp")
    two = home_with(tmp_path / "b", protocol="tcp", join=one.settings().listen)
    async with started(one, is_open=True):
        async with started(two, is_open=True):
            await until(lambda: "sessions with other routers: 1" in caplog.text)
        caplog.clear()
        await until(lambda: "sessions with other routers: 0" in caplog.text)


async def test_an_address_that_is_taken(tmp_path: Path) -> None:
    home = home_with(tmp_path / "a", "home")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        where = f"tls/127.0.0.1:{taken.getsockname()[1]}"
        home.tell(listen=(where,))
        with pytest.raises(OverlayUnavailable, match=f"cannot listen at {where}") as caught:
            await Router(home, home.settings(), is_open=False).start()
    assert "--listen" in caught.value.hint


async def test_a_router_that_was_not_started_is_closed(tmp_path: Path) -> None:
    home = home_with(tmp_path / "a", "home")
    router = Router(home, home.settings(), is_open=False)
    assert router.joined == 0
    await router.close()


def test_a_router_is_open_or_has_accounts(tmp_path: Path) -> None:
    accounts, none = home_with(tmp_path / "a", "home"), home_with(tmp_path / "b")
    assert accounts_of(accounts, is_open=False) == accounts.accounts()
    assert accounts_of(none, is_open=True) is None
    with pytest.raises(ConfigurationError, match=r"the router has accounts \(home\)") as caught:
        accounts_of(accounts, is_open=True)
    assert "--open" in caught.value.hint
    with pytest.raises(ConfigurationError, match="nobody has an account") as caught:
        accounts_of(none, is_open=False)
    assert "rossec router accounts add" in caught.value.hint
