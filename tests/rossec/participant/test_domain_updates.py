from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ca.errors import DomainsRefused, NotAdmitted, RevocationRefused, RevocationsStale, Revoked
from ca.revocation.lists import digest
from ca.revocation.trust_status import TrustStatus
from rossec.clock import Clock
from rossec.errors import AnswerMalformed, AnswerRefused, RossecError
from rossec.home import NodeHome
from rossec.participant.master_updates import DomainUpdates
from rossec.ros.names import DOMAINS, FOREIGN_PROOFS, FOREIGN_REVOCATIONS, UPDATE_DOMAINS
from rossec.ros.xmlrpc import Fault
from rossec.saved_statements import DomainFiles
from tests.support.domains import Pair, SomeNode, domains, foreign, revoked, revoked_tree
from tests.support.pki import NOW

DOMAIN = "hospital.example"
KEY = b"k" * 32


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: NOW))


class Robot:
    """A node of the home, and its master, which answers from `answers`."""

    def __init__(self, root: Path, *, listed: bool = True) -> None:
        self.pair = pair = Pair()
        self.home = NodeHome(root, "/robot")
        self.files = DomainFiles(self.home, pair.home.anchor)
        self.anchors = pair.anchors if listed else self.files.anchors()
        self.trust_status = TrustStatus(self.anchors, pair.own)
        self.news: list[bool] = []
        self.used: list[str] = []
        self.updates = DomainUpdates(self.trust_status, self.files, self.news.append, lambda: self.used)
        self.called: list[tuple[Any, ...]] = []
        self.answers: dict[str, Callable[..., object]] = {
            DOMAINS: self.listed,
            FOREIGN_REVOCATIONS: self.word,
        }
        self.data = revoked(pair.hospital)

    def listed(self, held: bytes) -> bytes:
        return b"" if held == digest(self.anchors.data) else self.anchors.data

    def word(self, _domain: str, held: bytes) -> object:
        data = b"" if held == digest(self.data) else self.data
        return [data, self.pair.master.stamp(self.data), [self.pair.master.leaf]]

    async def call(self, method: str, *params: object) -> object:
        self.called.append((method, *params))
        if method not in self.answers:
            raise Fault(1, f"<class 'Exception'>:method \"{method}\" is not supported")
        return self.answers[method](*params)

    def methods(self) -> list[str]:
        called, self.called = self.called, []
        return [method for method, *_ in called]

    def newer(self, *entries: Any, seq: int = 2) -> bytes:
        return domains(self.pair.home, *entries, seq=seq)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


async def test_a_session_begins_with_the_list_and_every_foreign_word(robot: Robot) -> None:
    await robot.updates.session_opened(robot.call)
    assert robot.called == [
        (DOMAINS, digest(robot.anchors.data)),
        (DOMAINS, digest(b"")),
        (FOREIGN_REVOCATIONS, DOMAIN, digest(b"")),
    ]
    robot.trust_status.check(DOMAIN, KEY, NOW)
    assert robot.news == [True]
    assert robot.files.load_foreign(DOMAIN) == robot.data


async def test_a_newer_list_is_saved_and_its_domains_fetched(tmp_path: Path) -> None:
    robot = Robot(tmp_path, listed=False)
    listed = domains(robot.pair.home, foreign(robot.pair.hospital))
    robot.answers[DOMAINS] = lambda _: listed
    await robot.updates.heartbeat(robot.call)
    assert robot.methods() == [DOMAINS, FOREIGN_REVOCATIONS]
    assert robot.files.load_domains() == listed
    robot.trust_status.check(DOMAIN, KEY, NOW)
    robot.answers[DOMAINS] = lambda _: b""
    await robot.updates.heartbeat(robot.call)
    assert robot.methods() == [DOMAINS], "it is fresh, and nobody of it is here"


async def test_what_is_in_use_is_fetched_each_time_else_at_half_its_age(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    await robot.updates.session_opened(robot.call)
    robot.methods()
    robot.used = [DOMAIN, "elsewhere"]
    await robot.updates.heartbeat(robot.call)
    assert robot.methods() == [DOMAINS, FOREIGN_REVOCATIONS]
    robot.used = []
    for age, fetched in ((1700, []), (1900, [FOREIGN_REVOCATIONS])):
        monkeypatch.setattr("rossec.clock.HOST", Clock(partial(int, NOW + age)))
        await robot.updates.heartbeat(robot.call)
        assert robot.methods() == [DOMAINS, *fetched]


async def test_a_domain_without_a_list_is_asked_for_each_time(robot: Robot) -> None:
    """Its master may be heard of a moment after this node's session began."""
    robot.answers[FOREIGN_REVOCATIONS] = lambda *_: [b"", b"", []]
    await robot.updates.session_opened(robot.call)
    robot.methods()
    await robot.updates.fetch_wanted(robot.call)
    robot.answers[FOREIGN_REVOCATIONS] = robot.word
    await robot.updates.fetch_wanted(robot.call)
    assert robot.methods() == [FOREIGN_REVOCATIONS] * 2
    robot.trust_status.check(DOMAIN, KEY, NOW)
    await robot.updates.fetch_wanted(robot.call)
    assert robot.methods() == []


async def test_a_master_of_an_older_version_is_used_without_domains(robot: Robot) -> None:
    del robot.answers[DOMAINS]
    await robot.updates.session_opened(robot.call)
    await robot.updates.heartbeat(robot.call)
    assert robot.methods() == [DOMAINS]
    robot.answers[DOMAINS] = lambda _: b""
    await robot.updates.session_opened(robot.call)
    assert FOREIGN_REVOCATIONS in robot.methods(), "another session, another master"


@pytest.mark.parametrize(
    "error", [Fault(1, "rossec: internal error"), AnswerRefused("no rule allows this method")]
)
async def test_a_call_that_fails_is_made_again_at_the_next_heartbeat(
    robot: Robot, error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_: bytes) -> object:
        raise error

    robot.answers[DOMAINS] = fail
    await robot.updates.session_opened(robot.call)
    assert robot.methods() == [DOMAINS, FOREIGN_REVOCATIONS], "of the domains that are known"
    robot.trust_status.check(DOMAIN, KEY, NOW)
    robot.used = [DOMAIN]
    await robot.updates.heartbeat(robot.call)
    assert robot.methods() == [DOMAINS, FOREIGN_REVOCATIONS]
    assert caplog.text.count(f"{DOMAINS}: ") == 1, "the same is said once"
    newer = robot.newer(foreign(robot.pair.hospital, label="clinic"))
    for answer in (lambda _: newer, lambda _: b"", fail):
        robot.answers[DOMAINS] = answer
        await robot.updates.heartbeat(robot.call)
    assert robot.files.load_domains() == newer
    assert caplog.text.count(f"{DOMAINS}: ") == 2, "it was over meanwhile"


async def test_a_master_with_an_older_list_receives_the_newer_one(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    old = robot.anchors.data
    robot.updates.take_domains(robot.newer(foreign(robot.pair.hospital)))
    robot.answers[DOMAINS] = lambda _: old
    robot.answers[UPDATE_DOMAINS] = lambda _: 1
    await robot.updates.heartbeat(robot.call)
    assert (UPDATE_DOMAINS, robot.anchors.data) in robot.called
    assert "was its home restored from a backup?" in caplog.text
    assert robot.anchors.data != old


async def test_a_master_without_a_list_receives_it(robot: Robot) -> None:
    robot.answers[DOMAINS] = lambda _: b""
    robot.answers[UPDATE_DOMAINS] = lambda _: 1
    await robot.updates.session_opened(robot.call)
    assert (UPDATE_DOMAINS, robot.anchors.data) in robot.called


async def test_a_master_that_refuses_the_newer_list_is_used_all_the_same(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_: bytes) -> object:
        raise AnswerRefused("not newer")

    robot.answers |= {DOMAINS: lambda _: b"", UPDATE_DOMAINS: refuse}
    await robot.updates.session_opened(robot.call)
    assert "not newer" in caplog.text
    robot.trust_status.check(DOMAIN, KEY, NOW)


@pytest.mark.parametrize("answer", [5, None, [b""]])
async def test_a_malformed_list_of_domains_is_not_taken(robot: Robot, answer: object) -> None:
    held = robot.anchors.data
    robot.answers[DOMAINS] = lambda _: answer
    await robot.updates.session_opened(robot.call)
    assert robot.anchors.data == held


async def test_a_forged_list_of_domains_changes_nothing(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    other = Pair()
    forged = domains(other.home, foreign(other.hospital, label="clinic"), seq=9)
    robot.answers[DOMAINS] = lambda _: forged
    for _ in range(2):
        await robot.updates.heartbeat(robot.call)
    assert robot.anchors.listed("clinic") is None
    assert caplog.text.count("not a list of domains of this authority") == 1
    with pytest.raises(DomainsRefused):
        robot.updates.take_domains(forged)
    assert robot.files.load_domains() is None


async def test_a_master_out_of_reach_ends_the_call(robot: Robot) -> None:
    async def call(method: str, *params: object) -> object:
        raise RossecError("the master is out of reach")

    with pytest.raises(RossecError, match="out of reach"):
        await robot.updates.session_opened(call)
    with pytest.raises(RossecError, match="out of reach"):
        await robot.updates.heartbeat(call)


@pytest.mark.parametrize("answer", [5, [], [b"", b""], [b"", b"", b""], [b"", b"", [b"", b"", b""]]])
async def test_a_malformed_foreign_word_is_not_taken(
    robot: Robot, answer: object, caplog: pytest.LogCaptureFixture
) -> None:
    robot.answers[FOREIGN_REVOCATIONS] = lambda *_: answer
    await robot.updates.session_opened(robot.call)
    with pytest.raises(RevocationsStale):
        robot.trust_status.check(DOMAIN, KEY, NOW)
    assert f"{DOMAIN}: " in caplog.text


def test_a_pushed_revocation_takes_effect_and_tells(robot: Robot) -> None:
    new = revoked(robot.pair.hospital, KEY, seq=2)
    stamp, chain = robot.pair.master.stamp(new, 2), [robot.pair.master.leaf]
    robot.updates.take_foreign(DOMAIN, new, stamp, chain)
    with pytest.raises(Revoked):
        robot.trust_status.check(DOMAIN, KEY, NOW)
    robot.updates.take_foreign(DOMAIN, b"", stamp, chain)
    assert robot.news == [True, False], "the same again is no news"
    assert robot.files.load_foreign(DOMAIN) == new


def test_a_pushed_list_whose_word_is_refused_revokes_all_the_same(robot: Robot) -> None:
    new = revoked(robot.pair.hospital, KEY, seq=2)
    with pytest.raises(RevocationsStale):
        robot.updates.take_foreign(DOMAIN, new, b"", [])
    with pytest.raises(Revoked):
        robot.trust_status.check(DOMAIN, KEY, NOW)
    assert robot.news == [True]


def test_what_the_master_may_not_push(robot: Robot) -> None:
    pair = robot.pair
    stamp, chain = pair.master.stamp(robot.data), [pair.master.leaf]
    new = revoked(pair.hospital, KEY, seq=2)
    robot.updates.take_foreign(DOMAIN, new, pair.master.stamp(new, 2), chain)
    with pytest.raises(RevocationRefused, match="is older than"):
        robot.updates.take_foreign(DOMAIN, robot.data, stamp, chain)
    with pytest.raises(NotAdmitted, match="not listed"):
        robot.updates.take_foreign("elsewhere", robot.data, stamp, chain)
    with pytest.raises(AnswerMalformed):
        robot.updates.take_foreign(DOMAIN, b"", stamp, [pair.master.leaf, 5])
    with pytest.raises(AnswerMalformed):
        robot.updates.take_foreign(DOMAIN, b"", stamp, [pair.master.leaf] * 3)


def test_a_domain_listed_again_remembers_its_saved_list(robot: Robot) -> None:
    pair = robot.pair
    new = revoked(pair.hospital, KEY, seq=2)
    robot.files.save_foreign(pair.hospital.anchor, new)
    assert robot.updates.take_domains(robot.newer(foreign(pair.hospital, label="clinic")))
    with pytest.raises(RevocationRefused, match="is older than"):
        robot.updates.take_foreign(DOMAIN, robot.data, b"", [])
    assert not robot.updates.take_domains(robot.anchors.data)


async def test_a_foreign_tree_is_proved_and_then_confirmed(robot: Robot) -> None:
    robot.data, leaves = revoked_tree(robot.pair.hospital, KEY, b"a" * 16)
    tried: list[int] = []

    def proofs(_domain: str, entries: list[bytes]) -> object:
        tried.append(len(entries))
        return [leaves.prove(each) if len(tried) > 1 else b"" for each in entries]

    robot.answers[FOREIGN_PROOFS] = proofs
    await robot.updates.session_opened(robot.call)
    await robot.updates.fetch_wanted(robot.call)
    assert tried == [1, 1], "the master did not have it the first time"
    with pytest.raises(RevocationsStale, match="no proof received yet"):
        robot.trust_status.check(DOMAIN, KEY, NOW)
    await robot.updates.fetch_wanted(robot.call)
    with pytest.raises(Revoked):
        robot.trust_status.check(DOMAIN, KEY, NOW)


@pytest.mark.parametrize("answer", [5, [b"x", b"y", b"z"], [b"no proof"]])
async def test_invalid_proofs_prove_nothing(robot: Robot, answer: object) -> None:
    robot.data, _ = revoked_tree(robot.pair.hospital, KEY)
    robot.answers[FOREIGN_PROOFS] = lambda *_: answer
    await robot.updates.session_opened(robot.call)
    with pytest.raises(RevocationsStale):
        robot.trust_status.check(DOMAIN, b"a" * 16, NOW)


async def test_the_word_of_another_node_than_a_master_counts_for_nothing(robot: Robot) -> None:
    liar = SomeNode(robot.pair.hospital, "/rounds/robot3")
    robot.answers[FOREIGN_REVOCATIONS] = lambda *_: [robot.data, liar.stamp(robot.data), [liar.leaf]]
    await robot.updates.session_opened(robot.call)
    with pytest.raises(RevocationsStale):
        robot.trust_status.check(DOMAIN, KEY, NOW)


async def test_a_domain_whose_trust_has_ended_is_asked_no_more(robot: Robot) -> None:
    await robot.updates.session_opened(robot.call)
    robot.updates.take_domains(robot.newer())
    robot.methods()
    robot.used = [DOMAIN]
    await robot.updates.heartbeat(robot.call)
    assert robot.methods() == [DOMAINS]


def test_a_disk_that_fails_leaves_the_list_as_it_was(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: bytes) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(robot.files, "save_domains", full)
    with pytest.raises(OSError, match="disk full"):
        robot.updates.take_domains(robot.newer())
    assert robot.anchors.listed("hospital") is not None
