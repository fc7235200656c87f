"""The membership of an identity, with a form of a node that only records what it is told."""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from threading import Barrier, RLock, Thread
from typing import Any

import pytest

from ca.certificates import Identity
from ca.errors import CAError, RevocationsStale
from ca.keys.signing import PublicKey
from ca.revocation import trust_status
from ca.revocation.lists import RevocationList, RevocationTree, Timestamp, digest, open_list, sign_timestamp
from grants.model import Right
from rossec import clock
from rossec.errors import AnswerRefused, ChannelClosed, ConfigurationError, RossecError
from rossec.home import NodeHome
from rossec.net.aio import SecureStream
from rossec.net.context import SecureContext
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable, Dialer
from rossec.participant.membership import LoadedIdentity, Membership
from rossec.participant.registrations import PublisherGrace
from rossec.ros.names import MASTER, REVOCATION_UPDATE, parse_uri
from rossec.ros.xmlrpc import Fault
from tests.rossec.participant.test_connections import FakeStream, make_connection
from tests.rossec.participant.test_identity_renewal import BEGIN, LIFE, below
from tests.support.site import DAY, HOUR, Site
from tests.support.witness import until

TOPIC = "/robot/pose"
REGISTER = ("registerPublisher", TOPIC, "std_msgs/String", "http://127.0.0.1:1")


class Form:
    """A form of a node, the table of its connections, and their watchdog; it cuts nothing."""

    domains: frozenset[str] = frozenset()

    def __init__(self, site: Site, loaded: LoadedIdentity | None = None) -> None:
        self.site = site
        self.loaded = loaded or LoadedIdentity(site.enroll("/robot"), "/robot")
        self.access = Access(self.loaded.trust_status)
        context = SecureContext(self.loaded.live_credentials, self.loaded.anchor.verify)
        self.dialer = Dialer("/robot", context, self.access.check_peer)
        self.grace = PublisherGrace(clock.counter())
        self.calls: list[str] = []
        self.fault = asyncio.Event()
        connections: Any = self
        self.membership = Membership(self.loaded, self.access, connections, self.grace, self)

    @asynccontextmanager
    async def running(self) -> AsyncIterator["Form"]:
        try:
            await self.membership.session.open()
            self.membership.start()
            yield self
        finally:
            await self.membership.close()

    async def dial_master(self) -> SecureStream[Identity]:
        assert self.site.master is not None
        return await self.dialer.rpc(*parse_uri(self.site.master.uri))

    async def dial_watch(self) -> SecureStream[Identity]:
        return await self.dial_master()

    async def restore(self) -> None:
        self.calls.append("restore")
        await self._register()

    async def rights_changed(self) -> None:
        self.calls.append("rights changed")
        await self._register()

    async def _register(self) -> None:
        try:
            await self.membership.session.call(*REGISTER)
        except AnswerRefused:
            self.calls.append("refused")

    def maintain(self) -> None:
        if "maintain" not in self.calls:
            self.calls.append("maintain")

    async def run(self) -> None:
        await self.fault.wait()
        raise ArithmeticError("a fault")

    def __iter__(self) -> Iterator[Any]:
        return iter(())

    def cut_ended(self, now: int) -> None:
        assert now <= clock.now()
        self.calls.append("close")

    def crashed(self, error: BaseException) -> None:
        self.calls.append(f"crashed: {error}")


@pytest.fixture(autouse=True)
def _periods(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.participant.membership.PERIOD", 0.05)
    monkeypatch.setattr(
        "rossec.participant.membership.ConnectionWatchdog", lambda connections, _: connections
    )


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def timestamp(site: Site, data: bytes) -> bytes:
    signer, seq = site.enroll(MASTER).credentials().signer, open_list(data, site.anchor.public_key)
    return sign_timestamp(signer, Timestamp(seq.seq, digest(data), site.now(), 30))


def test_an_identity_is_loaded_with_the_list_it_saved(site: Site) -> None:
    data, home = site.revoke(bytes(32)), site.enroll("/robot")
    home.save_revocations(data)
    loaded = LoadedIdentity(home, "/robot")
    assert (loaded.name, loaded.identity) == ("/robot", site.identity("/robot"))
    assert loaded.live_credentials.current.chain == home.credentials().chain
    assert loaded.revocations.data == data
    assert loaded.anchor.public_key == site.anchor.public_key
    with pytest.raises(ConfigurationError, match=r"has no ca\.pem"):
        LoadedIdentity(NodeHome.of(site.root, "/other"), "/other")


async def test_grants_are_presented_before_registrations_on_each_connection(site: Site) -> None:
    site.publish("/robot", TOPIC)
    async with site.running(), Form(site).running() as form:
        assert form.calls == ["close", "restore"], "the list, then the registrations"
        form.grace.update(TOPIC, ["http://a:1"])
        await site.restart_master()
        await until(lambda: form.calls.count("restore") == 2, within=30)
        assert "refused" not in form.calls
        assert form.grace.update(TOPIC, []) == ["http://a:1"], "the master may not list it yet"
        assert form.membership.rights_version == 1, "the first list, none since"


async def test_a_grant_that_expired_while_the_node_was_off_is_renewed_first(site: Site) -> None:
    site.delegate()
    site.grant("/robot", Right.PUBLISH, TOPIC, begin=site.now() - HOUR, lifetime=-60, cap=DAY)
    async with site.running(), Form(site).running() as form:
        assert "refused" not in form.calls


async def test_a_master_that_renews_nothing_has_a_session_all_the_same(site: Site) -> None:
    site.grant("/robot", Right.PUBLISH, TOPIC, begin=site.now() - HOUR, lifetime=-60, cap=DAY)
    async with site.running(), Form(site).running() as form:
        assert form.calls == ["close", "restore", "refused"]


async def test_a_new_grant_is_presented_before_rights_change(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    async with site.running(), Form(site).running() as form:
        assert form.calls[-1] == "refused"
        before = form.membership.rights_version
        site.publish("/robot", TOPIC)
        await until(lambda: form.calls[-1] == "rights changed", within=10)
        assert form.membership.rights_version == before + 1
        assert "/robot: 1 new grants" in caplog.text
        assert "maintain" in form.calls


async def test_a_new_grant_is_held_while_the_master_is_away(site: Site) -> None:
    async with site.running(), Form(site).running() as form:
        assert site.master is not None
        await site.master.close()
        before = form.membership.rights_version
        site.publish("/robot", TOPIC)
        await until(lambda: form.access.holds(Right.PUBLISH, TOPIC, site.now()), within=10)
        await until(lambda: form.membership.rights_version == before + 1)
        await asyncio.sleep(0.2)
        assert {"rights changed", "crashed"}.isdisjoint(call.split(":")[0] for call in form.calls)
        with pytest.raises(RossecError, match="out of reach"):
            await form.membership.session.call("getPid")


async def test_a_grant_is_renewed_while_the_node_runs(site: Site) -> None:
    site.delegate()
    site.grant("/robot", Right.PUBLISH, TOPIC, begin=site.now(), lifetime=4, cap=DAY)
    async with site.running(), Form(site).running() as form:
        before = form.membership.rights_version
        await until(lambda: "rights changed" in form.calls, within=20)
        assert form.membership.rights_version == before + 1
        assert form.access.held_grants()[0].grant.expires > site.now() + 60


async def test_the_identity_is_renewed_while_the_node_runs(tmp_path: Path) -> None:
    site = Site(tmp_path / "site", clock=lambda: BEGIN)
    for name in ("/robot", MASTER):
        site.enroll(name, LIFE)
    site._clock = time.time
    site.intermediate = below(site)
    async with site.running(), Form(site).running() as form:
        await until(lambda: len(form.loaded.live_credentials.current.chain) == 2, within=20)


async def test_proofs_are_requested_and_then_connections_checked(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    site.revoke(bytes(32))
    async with site.running(), Form(site).running() as form:
        peer, before = site.identity("/viewer"), form.calls.count("close")
        with pytest.raises(RevocationsStale):
            form.access.check_peer(peer, site.now())
        await until(lambda: form.calls.count("close") > before, within=10)
        form.access.check_peer(peer, site.now())


def test_a_list_is_saved_before_it_is_used(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    form, master = Form(site), site.identity(MASTER)
    data, key = site.revoke(site.identity("/viewer").thumbprint), site.identity("/viewer")

    def fail(_: bytes) -> None:
        assert form.loaded.revocations.data == b""
        raise OSError("the disk is full")

    with monkeypatch.context() as full:
        full.setattr(NodeHome, "save_revocations", lambda _, saved: fail(saved))
        with pytest.raises(OSError, match="full"):
            form.membership.update_revocations(data, timestamp(site, data), master)
    assert form.loaded.revocations.data == b""
    assert form.calls == ["close"], "what is stale by now is closed"
    assert form.membership.rights_version == 0
    form.membership.update_revocations(data, timestamp(site, data), master)
    assert form.loaded.home.load_revocations() == form.loaded.revocations.data == data
    assert form.membership.rights_version == 1
    with pytest.raises(CAError, match="revoked"):
        form.access.check_peer(key, site.now())


def test_a_list_takes_effect_even_with_an_invalid_timestamp(site: Site) -> None:
    form, data = Form(site), site.revoke(bytes(32))
    with pytest.raises(CAError):
        form.membership.update_revocations(data, b"forged", site.identity(MASTER))
    assert form.calls == ["close"]
    assert form.loaded.revocations.data == data
    assert form.membership.rights_version == 1
    with pytest.raises(CAError):
        form.membership.update_revocations(b"", b"forged", site.identity(MASTER))
    assert form.calls == ["close", "close"]
    assert form.membership.rights_version == 1, "no new list"


def test_a_list_that_comes_by_many_connections_at_once_is_applied_once(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sidecar is told by a connection for each of its programs: verified, saved and enforced once."""
    form, data = Form(site), site.revoke(bytes(32))
    verified, saved, real = list[bytes](), list[bytes](), trust_status.open_statement

    def verify(given: bytes, key: PublicKey) -> RevocationList | RevocationTree:
        verified.append(given)
        return real(given, key)

    monkeypatch.setattr(trust_status, "open_statement", verify)
    monkeypatch.setattr(NodeHome, "save_revocations", lambda _, given: saved.append(given))
    stamp = timestamp(site, data)
    for _ in range(20):
        form.membership.take_push(REVOCATION_UPDATE, (data, stamp), site.identity(MASTER))
    assert verified == saved == [data]
    assert form.calls == ["close"]
    assert form.membership.rights_version == 1
    with pytest.raises(CAError):  # what is not the list in force is verified each time
        form.membership.take_push(REVOCATION_UPDATE, (data + b"x", stamp), site.identity(MASTER))
    assert verified == [data, data + b"x"]


def test_a_list_that_another_user_of_the_trust_status_took_is_enforced_here_too(site: Site) -> None:
    """A border router's things and its node have one; and a cut that failed is tried again."""
    form, data = Form(site), site.revoke(bytes(32))
    stamp, master = timestamp(site, data), site.identity(MASTER)
    form.loaded.revocations.update(data, site.now())
    form.membership.take_push(REVOCATION_UPDATE, (data, stamp), master)
    assert form.calls == ["close"]
    form.membership.take_push(REVOCATION_UPDATE, (data, stamp), master)
    assert form.calls == ["close"], "once"


def test_threads_that_bring_one_list_verify_it_once(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in rospy, where each connection of the master has a thread."""
    form, data = Form(site), site.revoke(bytes(32))
    verified, lock, real = list[bytes](), RLock(), trust_status.open_statement
    together, update = Barrier(8), form.access.update_revocations

    def verify(given: bytes, key: PublicKey) -> RevocationList | RevocationTree:
        verified.append(given)
        return real(given, key)

    def locked(*given: Any) -> None:
        together.wait()
        with lock:
            update(*given)

    monkeypatch.setattr(trust_status, "open_statement", verify)
    monkeypatch.setattr(form.access, "update_revocations", locked)
    push = (REVOCATION_UPDATE, (data, timestamp(site, data)), site.identity(MASTER))
    threads = [Thread(target=form.membership.take_push, args=push) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert verified == [data]
    assert form.calls, "whoever saw the change cuts"


@pytest.mark.attack("revocation-at-scale")
@pytest.mark.parametrize("moment", ["saved", "cut"])
def test_what_is_accepted_while_a_list_is_applied_is_judged_by_it(
    site: Site, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """Just before it takes effect, and while the first of its connections is being cut."""
    loaded = LoadedIdentity(site.enroll("/robot"), "/robot")
    form = Form(site, loaded)
    connections: ConnectionTable[Any] = ConnectionTable(loaded.trust_status)
    form.membership._connections = connections
    eve, save = site.identity("/eve"), NodeHome.save_revocations
    old = site.authority.store.newest_list()
    assert old is not None
    form.membership.update_revocations(old, timestamp(site, old), site.identity(MASTER))

    def stream() -> FakeStream:
        made = FakeStream("/eve", site.now() + HOUR)
        made.peer = eve
        return made

    before, caller, late = make_connection(site.now() + HOUR), stream(), make_connection(site.now() + HOUR)
    before.stream.peer = late.stream.peer = eve
    before.update_end()
    late.update_end()
    connections.add(before)
    refused: list[str] = []

    def come() -> None:
        connections.accept(caller, eve)
        try:
            form.access.check_peer(eve, site.now())  # as each form does before it reads a header
            connections.add(late)
        except (CAError, ChannelClosed) as error:
            refused.append(str(error))

    if moment == "saved":

        def save_late(home: NodeHome, data: bytes) -> None:
            come()
            save(home, data)

        monkeypatch.setattr(NodeHome, "save_revocations", save_late)
    else:
        before.stream.disconnect = come  # type: ignore[method-assign]
    data = site.revoke(eve.thumbprint)
    form.membership.update_revocations(data, timestamp(site, data), site.identity(MASTER))
    assert before.stream.reasons
    assert list(connections) == []
    if moment == "saved":  # the list before it still counted: the cut finds both
        assert refused == []
        assert caller.reasons == ["the peer's identity is revoked"]
        assert late.stream.reasons
    else:
        assert len(refused) == 1
        assert "is revoked" in refused[0]


def watchdog_fails(form: Form, _: pytest.MonkeyPatch) -> None:
    form.fault.set()


def maintenance_fails(form: Form, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ArithmeticError("a fault")

    monkeypatch.setattr(form, "maintain", fail)


def session_fails(form: Form, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = form.membership.session._stream
    assert stream is not None

    async def fail() -> SecureStream[Identity]:
        raise ArithmeticError("a fault")

    monkeypatch.setattr(form.membership.session, "_dial", fail)
    stream.abort("a test")


def update_fails(form: Form, monkeypatch: pytest.MonkeyPatch) -> None:
    async def fail() -> None:
        raise ArithmeticError("a fault")

    monkeypatch.setattr(form, "rights_changed", fail)
    form.site.publish("/robot", TOPIC)


async def fail_again() -> None:
    raise ArithmeticError("another fault")


@pytest.mark.parametrize("fails", [watchdog_fails, maintenance_fails, session_fails, update_fails])
async def test_a_task_that_crashes_ends_everything_once(
    site: Site, monkeypatch: pytest.MonkeyPatch, fails: Callable[[Form, pytest.MonkeyPatch], None]
) -> None:
    async with site.running(), Form(site).running() as form:
        fails(form, monkeypatch)
        await until(lambda: "crashed: a fault" in form.calls, within=20)
        another = form.membership.tasks.spawn(fail_again())
        await asyncio.wait([another])
        assert [call for call in form.calls if "crashed" in call] == ["crashed: a fault"]


async def test_a_fault_is_an_answer_of_the_master_and_no_crash(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")

    async def answer() -> None:
        form.calls.append("fault")
        raise Fault(1, "rossec: internal error")

    async with site.running(), Form(site).running() as form:
        with monkeypatch.context() as faulty:
            faulty.setattr(form, "rights_changed", answer)
            site.publish("/robot", TOPIC)
            await until(lambda: "fault" in form.calls, within=10)
            faulty.setattr(form, "restore", answer)
            await site.restart_master()
            await until(lambda: form.calls.count("fault") > 1, within=30)
        await until(lambda: "/robot: connected to the master again" in caplog.text, within=30)
        assert not [call for call in form.calls if "crashed" in call]


async def test_a_session_opened_later_is_watched_meanwhile(site: Site) -> None:
    """A connection may be made as soon as there is a list, and the master hang after that."""
    form, may_open = Form(site), asyncio.Event()

    async def opening() -> None:
        await may_open.wait()
        await form.membership.session.open()
        form.calls.append("opened")

    opens: Callable[[], Awaitable[None]] = opening
    async with site.running():
        form.membership.start(opens)
        await until(lambda: "maintain" in form.calls)
        assert len(form.membership.tasks) == 4
        may_open.set()
        await until(lambda: "opened" in form.calls)
        assert form.calls.count("restore") == 1
        await form.membership.close()
    assert len(form.membership.tasks) == 0
