"""Joins, calls and rounds of the service, with a face that is played."""

import asyncio
from collections.abc import Collection
from pathlib import Path
from typing import cast

import pytest

from ca.encoding import Value
from ca.enrollment.join import Issued, Named, RefusedMessage, RefuseReason, read
from ca.errors import EncodingError
from rossec.authority.keyservice import network
from rossec.authority.keyservice import network as module
from rossec.authority.keyservice.front_end import Handler
from rossec.authority.keyservice.network import NetworkWork
from rossec.authority.keyservice.process import FrontEndProcess
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.session import StatementCall
from rossec.clock import now
from rossec.errors import KeyServiceRefused, NotDelivered, RulesRefused
from rossec.home import NodeHome
from rossec.naming import rule_runner
from tests.rossec.authority.keyservice.test_work import POLICY, Working
from tests.support.witness import until


class PlayedFace:
    """A face whose node joins when the test says so, and that answers calls at once."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Value]] = []
        self.joins: asyncio.Queue[bytes] = asyncio.Queue()
        self.answers: asyncio.Queue[Value] = asyncio.Queue()
        self.error: Exception | None = None

    async def started(self) -> int:
        return 1

    async def call(self, method: str, arguments: list[Value], within: int) -> Value:
        self.calls.append((method, within))
        if self.error is not None:
            raise self.error
        items = arguments[0]
        return [""] * len(items) if isinstance(items, list) else 1

    async def run(self, join: Handler, name: Handler) -> None:
        self.name = name
        while True:
            self.answers.put_nowait(await join(await self.joins.get()))


class Playing:
    def __init__(self, root: Path, *, applies: bool, rules: bytes | None = None) -> None:
        self.working = Working(root, now())
        (self.working.home.path / "policy.yaml").write_text(POLICY)
        self.face = PlayedFace()
        self.network = NetworkWork(
            root, self.working.operations, cast("FrontEndProcess", self.face), applies=applies, rules=rules
        )


@pytest.mark.parametrize("applies", [True, False])
async def test_a_node_that_joins_gets_what_the_policy_gives_it(tmp_path: Path, applies: bool) -> None:
    playing = Playing(tmp_path, applies=applies)
    working, face = playing.working, playing.face
    request = working.request(working.invite())
    running = asyncio.ensure_future(playing.network.run())
    face.joins.put_nowait(request)
    async with asyncio.timeout(20):
        assert isinstance(await face.answers.get(), bytes)
    deposit = ("rossec.depositGrants", 15)
    await until(lambda: deposit in face.calls, within=20)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert working.grants() == 1


class BusyFace(PlayedFace):
    """Its nodes join at the same time."""

    def __init__(self, requests: list[bytes]) -> None:
        super().__init__()
        self.requests = requests

    async def run(self, join: Handler, name: Handler) -> None:
        await asyncio.gather(*map(join, self.requests))
        await asyncio.Event().wait()


async def test_the_policy_is_applied_once_to_all_who_joined_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    working = Working(tmp_path, now())
    (working.home.path / "policy.yaml").write_text(POLICY)
    code, names = working.invite(4), [f"/fleet/{letter}" for letter in "abcd"]
    face = BusyFace([working.request(code, name) for name in names])
    apply, applied = AuthorityWork.apply, list[list[str]]()

    def applies(self: AuthorityWork, names: Collection[str] | None = None) -> None:
        applied.append(sorted(names or ()))
        apply(self, names)

    monkeypatch.setattr(AuthorityWork, "apply", applies)
    network = NetworkWork(tmp_path, working.operations, cast("FrontEndProcess", face), applies=True)
    running = asyncio.ensure_future(network.run())
    await until(lambda: sorted(name for each in applied for name in each) == names, within=20)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert sum(map(bool, applied)) < len(names), "it was applied for each node alone"
    assert working.grants() == len(names)


async def test_rounds_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "ROUND", 0.01)
    playing = Playing(tmp_path, applies=True)
    playing.working.work.join(playing.working.request(playing.working.invite()))
    running = asyncio.ensure_future(playing.network.run())
    await until(lambda: playing.working.grants() == 1, within=20)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_a_round_that_crashes_is_not_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(network, "ROUND", 0.01)
    crashed: list[int] = []

    def crash(_: AuthorityWork) -> None:
        crashed.append(len(crashed))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(AuthorityWork, "maintain", crash)
    running = asyncio.ensure_future(Playing(tmp_path, applies=True).network.run())
    await until(lambda: len(crashed) > 2, within=20)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert "a round of the authority failed" in caplog.text


async def test_a_master_that_fails_slowly_is_not_called_for_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each node that joins would wait for it."""
    monkeypatch.setattr(module, "SLOW", 0.0)
    monkeypatch.setattr(module, "PAUSE", 0.3)
    playing = Playing(tmp_path, applies=False)
    call = StatementCall(NodeHome(tmp_path / "x", "/ca"), "rossec.x", (b"a",), "the list", "later")
    running = asyncio.ensure_future(playing.network.run())
    await asyncio.sleep(0.05)
    playing.face.error = TimeoutError()
    for reason in ("no answer in time", "it is out of reach"):
        with pytest.raises(NotDelivered, match=reason):
            await asyncio.to_thread(playing.network.deliver, call)
    calls = [method for method, _ in playing.face.calls if method == "rossec.x"]
    assert len(calls) == 1
    playing.face.error = None
    await asyncio.sleep(0.35)
    assert await asyncio.to_thread(playing.network.deliver, call) == 1
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_a_call_that_fails_is_not_delivered(tmp_path: Path) -> None:
    playing = Playing(tmp_path, applies=False)
    node = NodeHome(tmp_path / "x", "/ca")
    call = StatementCall(node, "rossec.x", (b"a", [b"b"]), "the list", "later")
    with pytest.raises(NotDelivered, match="not started"):
        playing.network.deliver(call)
    running = asyncio.ensure_future(playing.network.run())
    await asyncio.sleep(0.05)
    assert await asyncio.to_thread(playing.network.deliver, call) == 1
    assert playing.network.has_master
    for error in (KeyServiceRefused("it is off"), TimeoutError()):
        playing.face.error = error
        with pytest.raises(NotDelivered, match="the master did not get the list") as caught:
            await asyncio.to_thread(playing.network.deliver, call)
        assert caught.value.hint == "later"
        assert not playing.network.has_master
    with pytest.raises(EncodingError, match="no plain value"):
        await asyncio.to_thread(playing.network.deliver, call._replace(statement=(5.0,)))
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_an_answer_that_is_waited_for_and_fails_stops_no_other_call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SLOW", 0.0)
    monkeypatch.setattr(AuthorityWork, "maintain", lambda _: None)  # whose calls would fail too
    playing = Playing(tmp_path, applies=False)
    node = NodeHome(tmp_path / "x", "/ca")
    call = StatementCall(node, "rossec.watchGraph", ("", 0), "a question", "later", waits=True)
    running = asyncio.ensure_future(playing.network.run())
    await asyncio.sleep(0.05)
    playing.face.error = TimeoutError()
    with pytest.raises(NotDelivered, match="no answer in time"):
        await asyncio.to_thread(playing.network.deliver, call)
    playing.face.error = None
    assert await asyncio.to_thread(playing.network.deliver, call) == 1
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


RULES = rule_runner.shipped_rules()
METADATA = b"<node><group>fleet</group><name>a</name></node>"


async def test_nodes_are_named_by_the_rules_of_the_authority(tmp_path: Path) -> None:
    playing = Playing(tmp_path, applies=False, rules=RULES)
    working, face = playing.working, playing.face
    code = working.invite(uses=3)
    running = asyncio.ensure_future(playing.network.run())
    try:
        async with asyncio.timeout(60):
            await until(lambda: hasattr(face, "name"), within=40)
            named = read(cast("bytes", await face.name(working.claim(code, METADATA))))
            assert named == Named("/fleet/a")
            for metadata, name, answer in (
                (METADATA, "/fleet/b", RefusedMessage(RefuseReason.NAME)),
                (METADATA.replace(b"fleet", b"other"), "/fleet/a", RefusedMessage(RefuseReason.NAME)),
                (b"<node>", "/fleet/a", RefusedMessage(RefuseReason.METADATA)),
            ):
                face.joins.put_nowait(working.request(code, name, metadata))
                assert read(cast("bytes", await face.answers.get())) == answer
            face.joins.put_nowait(working.request(code, "/fleet/a", METADATA))
            assert isinstance(read(cast("bytes", await face.answers.get())), Issued)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_what_was_issued_is_repeated_whatever_the_rules_say_now(tmp_path: Path) -> None:
    playing = Playing(tmp_path, applies=False)
    working, face = playing.working, playing.face
    code = working.invite()
    request = working.request(code, "/fleet/a", METADATA)
    running = asyncio.ensure_future(playing.network.run())
    try:
        async with asyncio.timeout(60):
            face.joins.put_nowait(request)
            unnamed = RefusedMessage(RefuseReason.UNNAMED)
            assert read(cast("bytes", await face.answers.get())) == unnamed
            working.work.join(request)
            face.joins.put_nowait(request)
            assert isinstance(read(cast("bytes", await face.answers.get())), Issued)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_rules_that_are_refused_end_it(tmp_path: Path) -> None:
    playing = Playing(tmp_path, applies=False, rules=b"<nothing/>")
    with pytest.raises(RulesRefused):
        await playing.network.run()
