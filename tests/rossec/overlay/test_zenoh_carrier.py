"""Messages through real routers, in this process."""

import asyncio
import builtins
import logging
import time
from collections.abc import Callable
from typing import Any

import pytest

from rossec.errors import OverlayUnavailable
from rossec.overlay import zenoh_carrier as carrier_module
from rossec.overlay.link_frames import MAX_FRAME
from rossec.overlay.zenoh_carrier import Carrier, open_session
from tests.support.overlay import carrier, router, routers_at, until
from tests.support.ports import free_port

KEY = "rossec/1/open/00112233445566778899aabbccddeeff"
OTHER = "rossec/1/open/ffeeddccbbaa99887766554433221100"


async def put_until(sender: Carrier, key: str, data: bytes, condition: Callable[[], object]) -> None:
    """Put the message again until it shows: nobody says when an inbox is known everywhere."""

    def put() -> object:
        sender.put(key, data)
        return condition()

    await until(put)


async def test_a_message_arrives_in_the_inbox_it_was_put_to() -> None:
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            others: list[bytes] = []
            bob.subscribe(KEY, got.append)
            bob.subscribe(OTHER, others.append)
            await put_until(alice, KEY, b"ping", lambda: got)
            assert set(got) == {b"ping"}
            assert others == []
            assert alice.router == bob.router == locator


@pytest.mark.parametrize("pattern", ["rossec/1/open/*", "rossec/1/open/0$*", "rossec/**"])
async def test_what_is_put_to_a_pattern_arrives_nowhere(pattern: str) -> None:
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            bob.subscribe(KEY, got.append)
            await put_until(alice, KEY, b"known", lambda: got)
            alice.put(pattern, b"guessed")
            await put_until(alice, KEY, b"last", lambda: got[-1] == b"last")
            assert b"guessed" not in got


async def test_a_whole_frame_arrives() -> None:
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            bob.subscribe(KEY, got.append)
            frame = bytes(range(256)) * (MAX_FRAME // 256)
            await put_until(alice, KEY, frame, lambda: got)
            assert got[0] == frame


async def test_a_closed_subscription_gets_nothing_more() -> None:
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            others: list[bytes] = []
            first = bob.subscribe(KEY, got.append)
            second = bob.subscribe(OTHER, others.append)
            await put_until(alice, KEY, b"ping", lambda: got)
            first.close()
            first.close()  # once is enough
            count = len(got)
            alice.put(KEY, b"late")
            await put_until(alice, OTHER, b"ping", lambda: others)
            first.deliver(b"it was on its way")
            assert len(got) == count
            second.close()


async def test_many_messages_wake_the_loop_a_few_times() -> None:
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            turns = 0
            take = bob._deliver

            def counted() -> Any:
                nonlocal turns
                turns += 1
                return take()

            bob._deliver = counted  # type: ignore[method-assign]
            got: list[bytes] = []
            bob.subscribe(KEY, got.append)
            await put_until(alice, KEY, b"", lambda: got)
            await asyncio.sleep(0.05)
            turns = 0
            for each in range(200):
                alice.put(KEY, b"%d" % each)
            time.sleep(0.5)  # noqa: ASYNC251 - a loop that is busy: what comes meanwhile is one turn
            await until(lambda: got and got[-1] == b"199")
            assert turns < 100


async def test_a_callback_that_crashes_does_not_stop_the_others(caplog: pytest.LogCaptureFixture) -> None:
    def crash(_data: bytes) -> None:
        raise ValueError("a bug")

    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            bob.subscribe(KEY, crash)
            bob.subscribe(KEY, got.append)
            with caplog.at_level(logging.ERROR):
                await put_until(alice, KEY, b"ping", lambda: got)
            assert "was not handled" in caplog.text


async def test_what_waits_in_a_flooded_inbox_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(carrier_module, "_MOST_WAITING", 10_000)
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            await until_subscribed(alice, bob, got.append)
            got.clear()
            for _ in range(50):
                alice.put(KEY, bytes(1000))
            time.sleep(0.3)  # noqa: ASYNC251 - the loop takes nothing meanwhile
            assert len(bob._arrived) <= 9
            await put_until(alice, KEY, b"after", lambda: b"after" in got)


async def until_subscribed(alice: Carrier, bob: Carrier, take: Callable[[bytes], None]) -> None:
    seen: list[bytes] = []

    def receive(data: bytes) -> None:
        seen.append(data)
        take(data)

    bob.subscribe(KEY, receive)
    await put_until(alice, KEY, b"", lambda: seen)


async def test_a_session_is_replaced_and_its_inboxes_are_read_on() -> None:
    with router() as locator:
        async with carrier(locator) as alice, carrier(locator) as bob:
            got: list[bytes] = []
            await until_subscribed(alice, bob, got.append)
            bob._session.close()  # type: ignore[no-untyped-call]
            bob.put(KEY, b"lost")
            assert bob.router == ""
            bob.reopen()
            bob.reopen()  # it is replaced once
            await until(lambda: bob._reopening is None)
            assert bob.router == locator
            got.clear()
            await put_until(alice, KEY, b"again", lambda: got)
            assert got[0] == b"again"


async def test_a_session_is_replaced_once_a_router_is_there(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(carrier_module, "_REOPEN_AFTER", 0.05)
    with router() as locator:
        alice = await Carrier.open(routers_at(locator))
    alice.reopen()
    await until(lambda: "trying again" in caplog.text)
    with router(locator):
        await until(lambda: alice._reopening is None)
        assert alice.router == locator
        await alice.close()


async def test_a_carrier_is_closed_while_its_session_is_replaced() -> None:
    with router() as locator:
        alice = await Carrier.open(routers_at(locator))
    alice.reopen()
    await alice.close()
    alice.reopen()
    assert alice._reopening is None
    with pytest.raises(OverlayUnavailable, match="closed"):
        alice.subscribe(KEY, print)


async def test_a_failure_to_replace_the_session_is_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def crash(_settings: object) -> None:
        raise ValueError("a bug")

    with router() as locator:
        async with carrier(locator) as alice:
            monkeypatch.setattr(carrier_module, "open_session", crash)
            alice.reopen()
            await until(lambda: alice._reopening is None)
            assert "was not replaced" in caplog.text


async def test_without_a_router() -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(OverlayUnavailable, match=f"no router takes the account open: {where}") as caught:
        await Carrier.open(routers_at(where))
    assert "account file" in caught.value.hint


async def test_a_session_that_nobody_waits_for_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Any] = []

    def slowly(settings: dict[str, object]) -> Any:
        time.sleep(0.2)
        opened.append(open_session(settings))
        return opened[0]

    monkeypatch.setattr(carrier_module, "open_session", slowly)
    with router() as locator:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.05):
                await Carrier.open(routers_at(locator))
        await until(lambda: opened and opened[0].is_closed())


async def test_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def refuse(name: str, *arguments: Any) -> Any:
        if name == "zenoh":
            raise ImportError(name)
        return imported(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(OverlayUnavailable, match="not installed") as caught:
        await Carrier.open(routers_at("tcp/127.0.0.1:1"))
    assert caught.value.hint == "pip install rossec[overlay]"


def test_what_zenoh_refuses_is_said_without_paths_of_its_builders() -> None:
    settings = {"mode": "client", "connect/endpoints": ["tcp/127.0.0.1:1"]}
    with pytest.raises(OverlayUnavailable, match="Unable to connect") as caught:
        open_session(settings)
    assert "/root" not in str(caught.value)
