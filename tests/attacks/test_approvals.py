"""Approvals that nobody gave, against the record of an authority and its commands."""

import hashlib
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from ca.approvals.passkeys import Approval
from ca.approvals.statement import GrantStatement
from ca.errors import ApprovalRefused
from ca.store.record import Store
from rossec.authority.home import AuthorityHome
from tests.support import refusal_texts
from tests.support.approving import registered, state
from tests.support.commands import PASSPHRASE, Shell, refused
from tests.support.passkeys import UP, Assertion, Passkey

NOW = int(time.time())
SHOWN, WIDER = b"the coarse position", b"the exact position"


@pytest.fixture
def device() -> Passkey:
    return Passkey(counts=False)  # as a phone that synchronizes its passkeys


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of an authority."""
    root = tmp_path_factory.mktemp("made")
    return AuthorityHome.create(root, "home", PASSPHRASE, NOW).path


@pytest.fixture
def shell(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    shell = Shell(tmp_path / "home", capsys)
    shutil.copytree(made, shell.root / "ca")
    return shell


@pytest.fixture
def store(shell: Shell, device: Passkey) -> Iterator[Store]:
    with closing(AuthorityHome.at(shell.root).store()) as store:
        store.passkeys.add(registered(device, at=NOW))
        yield store


def grant(store: Store, id: bytes = b"i" * 16, payload: bytes = SHOWN) -> Approval:  # noqa: A002
    """A statement, without any assertion."""
    what = GrantStatement(b"r" * 16, hashlib.sha256(payload).digest())
    nothing = Assertion(b"", b"", b"", b"")
    return Approval.of(state(what, id=id, store=store, made=NOW), payload, nothing, NOW)  # type: ignore[arg-type]  # the same fields


def signed(approval: Approval, assertion: Assertion) -> Approval:
    return approval._replace(
        passkey=assertion.credential,
        client_data=assertion.client_data,
        authenticator_data=assertion.authenticator_data,
        signature=assertion.signature,
    )


def challenge(approval: Approval) -> bytes:
    return hashlib.sha256(approval.statement).digest()


Attack = Callable[[Store, Passkey], Approval]


def another_statement(store: Store, device: Passkey) -> Approval:
    touched = device.sign(challenge(grant(store)))
    return signed(grant(store, payload=WIDER), touched)


def another_payload(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, device.sign(challenge(approval)))._replace(payload=WIDER)


def replayed(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    approval = signed(approval, device.sign(challenge(approval)))
    store.approvals.add(approval)
    return approval


def cloned(store: Store, _: Passkey) -> Approval:
    counting = Passkey()
    store.passkeys.add(registered(counting, "key", NOW))
    copy = counting.clone()
    first, second = grant(store), grant(store, b"j" * 16)
    store.approvals.add(signed(first, counting.sign(challenge(first))))
    return signed(second, copy.sign(challenge(second)))


def at_another_page(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, device.sign(challenge(approval), origin="https://rossec.example"))


def in_a_frame(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, device.sign(challenge(approval), cross_origin=True))


def for_another_site(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, device.sign(challenge(approval), rp_id="example.org"))


def unlocked_by_nobody(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, device.sign(challenge(approval), flags=UP))


def a_login(store: Store, device: Passkey) -> Approval:
    return signed(grant(store), device.sign(b"a login challenge, of 32 bytes  "))


def by_an_unknown_phone(store: Store, _: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, Passkey().sign(challenge(approval)))


def by_a_removed_phone(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    store.remove_passkey(device.id, "stolen", NOW)
    return signed(approval, device.sign(challenge(approval)))


def with_its_id(store: Store, device: Passkey) -> Approval:
    forger = Passkey(counts=False)
    forger.id = device.id
    approval = grant(store)
    return signed(approval, forger.sign(challenge(approval)))


def too_late(store: Store, device: Passkey) -> Approval:
    approval = grant(store)
    return signed(approval, device.sign(challenge(approval)))._replace(at=NOW + 301)


@pytest.mark.attack("forged-approval")
@pytest.mark.parametrize(
    ("attack", "refusal"),
    [
        (another_statement, refusal_texts.OTHER_CHALLENGE),
        (another_payload, refusal_texts.STATEMENT_REFUSED),
        (replayed, refusal_texts.APPROVAL_USED),
        (cloned, refusal_texts.PASSKEY_CLONED),
        (at_another_page, refusal_texts.OTHER_ORIGIN),
        (in_a_frame, refusal_texts.OTHER_ORIGIN),
        (for_another_site, refusal_texts.OTHER_ORIGIN),
        (unlocked_by_nobody, refusal_texts.NOT_VERIFIED),
        (a_login, refusal_texts.OTHER_CHALLENGE),
        (by_an_unknown_phone, refusal_texts.PASSKEY_UNKNOWN),
        (by_a_removed_phone, refusal_texts.PASSKEY_UNKNOWN),
        (with_its_id, refusal_texts.ASSERTION_FORGED),
        (too_late, refusal_texts.APPROVAL_OUTDATED),
    ],
)
def test_an_approval_that_nobody_gave_is_refused(
    store: Store, device: Passkey, attack: Attack, refusal: str
) -> None:
    forged = attack(store, device)
    before = store.approvals.all()
    with pytest.raises(ApprovalRefused, match=refusal) as error:
        store.approvals.add(forged)
    assert error.value.hint
    assert store.approvals.all() == before


@pytest.mark.attack("forged-approval")
def test_two_browsers_at_one_statement_approve_it_once(shell: Shell, store: Store, device: Passkey) -> None:
    statement = grant(store)
    both = [signed(statement, device.sign(challenge(statement))) for _ in range(2)]
    with closing(AuthorityHome.at(shell.root).store()) as other:
        for used, approval in zip((store, other), both, strict=True):
            with suppress(ApprovalRefused):
                used.approvals.add(approval)
    assert len(store.approvals.all()) == 1


@pytest.mark.attack("restored-approval")
def test_nothing_from_before_a_restore_approves_after_it(shell: Shell, store: Store, device: Passkey) -> None:
    waits, shown = grant(store), grant(store, b"j" * 16)
    store.approvals.add(signed(waits, device.sign(challenge(waits))))
    file = str(shell.root / "backup")
    assert shell.unlocked("ca", "backup", file).code == 0
    store.remove_passkey(device.id, "stolen", NOW)
    store.close()
    said = shell.unlocked("ca", "restore", file, "--without-list", "--over", "home", "--forget", "2")
    assert "no phone can approve any more" in said.err
    with closing(AuthorityHome.at(shell.root).store()) as restored:
        assert restored.approvals.waiting() == []
        assert restored.passkeys.active() == []
        with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
            restored.approvals.add(signed(shown, device.sign(challenge(shown))))
        other = Passkey()
        restored.passkeys.add(registered(other, at=NOW))
        with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
            restored.approvals.add(signed(shown, other.sign(challenge(shown))))
    assert shell("ca", "log", "verify").code == 0


@pytest.mark.attack("rewritten-record")
def test_a_rewritten_approval_is_found(shell: Shell, store: Store, device: Passkey) -> None:
    approval = grant(store)
    store.approvals.add(signed(approval, device.sign(challenge(approval))))
    store.close()
    with closing(sqlite3.connect(AuthorityHome.at(shell.root).path / "ca.db")) as db:
        db.execute("DROP TRIGGER approval_no_UPDATE")
        db.execute("UPDATE approval SET payload = ?", (WIDER,))
        db.commit()
    refused(shell("ca", "log", "verify"), "the approval of log entry")
