"""Somebody with an account at a real router wants more: to read others' inboxes, or to find them.

The attacker uses Zenoh itself, as any customer can, in every mode that it has.
"""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from rossec.errors import OverlayUnavailable
from rossec.overlay.documents import Routers
from rossec.overlay.homes import RouterHome
from rossec.overlay.link_frames import MAX_FRAME
from rossec.overlay.router_settings import client_settings
from rossec.overlay.zenoh_carrier import Carrier, open_session
from tests.support.overlay import until
from tests.support.ports import free_port
from tests.support.routerprocess import RouterProcess, home_with, running

pytestmark = pytest.mark.attack("router-accounts")

BOX = "0123456789abcdef" * 2
HOME = f"rossec/1/home/{BOX}"
CLINIC = "rossec/1/clinic/" + "c" * 32
PATTERNS = ("**", "rossec/**", "rossec/1/home/*", "rossec/1/home/0$*", "rossec/1/*/*")
MODES = ("client", "peer", "router")


@pytest.fixture
def home(tmp_path: Path) -> Iterator[RouterHome]:
    """A router where home, a clinic and an attacker have accounts."""
    made = home_with(tmp_path / "router", "home", "clinic", "evil", protocol="tcp")
    with running(made):
        yield made


@pytest.fixture
async def pair(home: RouterHome) -> AsyncIterator[tuple[Carrier, Carrier]]:
    """The relays of home and of the clinic."""
    opened = [await Carrier.open(home.account_file(account)) for account in ("home", "clinic")]
    yield opened[0], opened[1]
    for each in opened:
        await each.close()


@contextmanager
def attacker(home: RouterHome, mode: str) -> Iterator[Any]:
    """A session of the account `evil`."""
    session = open_session({**client_settings(home.account_file("evil")), "mode": mode})
    try:
        yield session
    finally:
        session.close()  # type: ignore[no-untyped-call]


async def exchange(pair: tuple[Carrier, Carrier]) -> None:
    """Both send until each has heard the other."""
    alice, bob = pair
    heard: list[bytes] = []
    readers = alice.subscribe(HOME, heard.append), bob.subscribe(CLINIC, heard.append)

    def put() -> bool:
        alice.put(CLINIC, b"to the clinic")
        bob.put(HOME, b"to home")
        return len(set(heard)) == 2

    await until(put)
    for each in readers:
        each.close()


@pytest.mark.parametrize("mode", MODES)
async def test_it_reads_inboxes_of_others(home: RouterHome, pair: tuple[Carrier, Carrier], mode: str) -> None:
    got: list[str] = []
    with attacker(home, mode) as session:
        for key in (HOME, CLINIC, *PATTERNS):
            session.declare_subscriber(key, lambda sample: got.append(str(sample.key_expr)))
        await exchange(pair)
        await asyncio.sleep(0.2)
        await exchange(pair)
        assert got == []


@pytest.mark.parametrize("mode", MODES)
async def test_it_asks_which_inboxes_there_are(
    home: RouterHome, pair: tuple[Carrier, Carrier], mode: str
) -> None:
    """Zenoh tells a publisher whether anybody reads what it publishes, also for a pattern."""
    alice, _ = pair
    await exchange(pair)
    reader = alice.subscribe(HOME, lambda _: None)
    remote = zenoh.Locality.REMOTE
    with attacker(home, mode) as session:
        asked = [session.declare_publisher(key, allowed_destination=remote) for key in (HOME, *PATTERNS)]
        tokens: list[object] = []
        for key in PATTERNS[1:]:
            session.liveliness().declare_subscriber(key, tokens.append, history=True)
        await asyncio.sleep(0.5)
        assert [bool(each.matching_status.matching) for each in asked] == [False] * len(asked)
        assert tokens == []
        own = str(session.zid())
        for selector in ("@/**", "rossec/**"):
            answers = [each.ok or each.err for each in session.get(selector, timeout=0.5)]
            keys = [str(getattr(each, "key_expr", own)) for each in answers]
            assert not [key for key in keys if own not in key]
    reader.close()


@pytest.mark.parametrize("mode", MODES)
async def test_it_sends_to_inboxes_that_it_does_not_know(
    home: RouterHome, pair: tuple[Carrier, Carrier], mode: str
) -> None:
    alice, bob = pair
    got: list[bytes] = []
    reader = alice.subscribe(HOME, got.append)
    with attacker(home, mode) as session:
        for _ in range(10):
            for key in PATTERNS:
                session.put(key, b"guessed")
            await asyncio.sleep(0.02)

        def put() -> list[bytes]:
            bob.put(HOME, b"known")
            return got

        await until(put)
        assert set(got) == {b"known"}
    reader.close()


async def test_it_sends_what_fits_no_frame(home: RouterHome, pair: tuple[Carrier, Carrier]) -> None:
    alice, _ = pair
    got: list[int] = []
    reader = alice.subscribe(HOME, lambda data: got.append(len(data)))
    with attacker(home, "client") as session:
        for _ in range(20):
            session.put(HOME, bytes(MAX_FRAME + 1))
            session.put(HOME, bytes(8 * MAX_FRAME))
            session.put(HOME, bytes(MAX_FRAME))
            await asyncio.sleep(0.02)
        await until(lambda: got)
    assert set(got) == {MAX_FRAME}
    reader.close()


async def test_it_takes_the_identifier_of_another_session(
    home: RouterHome, pair: tuple[Carrier, Carrier]
) -> None:
    """While the other is connected, and when it is gone."""
    got: list[str] = []
    taken = {**client_settings(home.account_file("evil")), "id": "abad1dea"}
    with open_session({**client_settings(home.account_file("home")), "id": "abad1dea"}):
        with pytest.raises(OverlayUnavailable):
            await asyncio.to_thread(open_session, taken)
        await exchange(pair)
    with open_session(taken) as session:
        session.declare_subscriber(HOME, lambda sample: got.append(str(sample.key_expr)))
        await exchange(pair)
        await asyncio.sleep(0.2)
        await exchange(pair)
    assert got == []


async def test_it_claims_to_be_the_shortest_way_between_two_routers(tmp_path: Path) -> None:
    """As a router with links of the least weight; what it was sent, it could only drop."""
    one = home_with(tmp_path / "one", "home", "clinic", "evil")
    two = RouterHome(tmp_path / "two")
    two.take(one.share())
    two.tell(listen=(f"tls/127.0.0.1:{free_port()}",))
    ways = [each.settings().listen[0] for each in (one, two)]
    with running(one), running(two):
        accounts = one.account_file("home"), replace(one.account_file("clinic"), locators=(ways[1],))
        alice, bob = opened = [await Carrier.open(each) for each in accounts]
        await exchange((alice, bob))
        evil = client_settings(replace(one.account_file("evil"), locators=tuple(ways)))
        evil |= {"mode": "router", "connect/timeout_ms": -1, "connect/exit_on_failure": False}
        zids: list[str] = []

        def both_are_known(session: Any) -> bool:
            zids[:] = map(str, session.info.routers_zid())
            return len(zids) == len(ways)

        for _ in range(2):  # once to know the routers, and with links to them
            links = [{"dst_zid": zid, "weight": 1} for zid in zids]
            evil["routing/router/linkstate/transport_weights"] = links
            with await asyncio.to_thread(open_session, evil) as session:
                await until(partial(both_are_known, session))
                await asyncio.sleep(1.0)  # the routers are told
                async with asyncio.timeout(5):
                    await exchange((alice, bob))
        for each in opened:
            await each.close()


@pytest.mark.parametrize("account", ["clinic", "nobody", "_router"])
async def test_it_guesses_a_password(home: RouterHome, account: str) -> None:
    known = home.account_file("evil")
    guess = {**client_settings(known), "transport/auth/usrpwd/user": account}
    with pytest.raises(OverlayUnavailable):
        await asyncio.to_thread(open_session, guess)
    nothing = {path: each for path, each in guess.items() if "usrpwd" not in path}
    with pytest.raises(OverlayUnavailable):
        await asyncio.to_thread(open_session, nothing)


async def test_it_takes_the_place_of_a_router(tmp_path: Path) -> None:
    """A relay gives its account to nobody that the operator's authority did not certify."""
    real, fake = home_with(tmp_path / "real", "home"), home_with(tmp_path / "fake", "home")
    with running(fake):
        found = real.account_file("home")
        there = Routers(fake.settings().listen, found.account, found.password, found.root_certificate)
        with pytest.raises(OverlayUnavailable, match="no router takes the account"):
            await Carrier.open(there)


async def test_the_routers_log_and_administration_name_no_inbox(tmp_path: Path) -> None:
    router = RouterProcess(home_with(tmp_path / "router", "home", "clinic", "evil"))
    await router.start(RUST_LOG="trace", PYTHONDEVMODE="1")
    opened = [await Carrier.open(router.routers(account)) for account in ("home", "clinic")]
    alice, bob = opened
    await exchange((alice, bob))
    with attacker(router.home, "client") as session:
        answers = [each.ok for each in session.get("@/*/router/**", timeout=0.5)]
    for each in opened:
        await each.close()
    assert await router.stop() == 0
    assert answers == []
    assert BOX not in router.log.read_text()
