"""Who may look, and whose passkeys approve."""

import sys
from pathlib import Path

import pytest

from ca.encoding import Value
from ca.errors import ApprovalRefused, StoreError
from rossec.authority.console.access import ConsoleAccess
from rossec.authority.console.messages import LoginChallenge, PhoneView, Proposal, from_value
from rossec.errors import KeyServiceRefused, PhoneCodeRefused
from tests.support import refusal_texts
from tests.support.consolework import ConsoleWork, ask, many
from tests.support.passkeys import ORIGIN, RP_ID, Assertion, Passkey


@pytest.fixture
def site(tmp_path: Path) -> ConsoleWork:
    return ConsoleWork(tmp_path)


@pytest.fixture
def access(site: ConsoleWork) -> ConsoleAccess:
    return ConsoleAccess(site.work, site.audit.append, site.elapsed)


def challenge(access: ConsoleAccess, operation: str, *arguments: Value) -> LoginChallenge:
    return from_value(LoginChallenge, ask(access, operation, *arguments))


def add(
    access: ConsoleAccess, phone: Passkey, name: str, code: str | None = None, operation: str = "add-passkey"
) -> Value:
    asked = challenge(access, "new-passkey", phone.origin, phone.rp_id)
    given = access.phone_code("a test") if code is None else code
    return ask(access, operation, asked.id, given, name, *phone.register(asked.challenge))


def login(access: ConsoleAccess, phone: Passkey, origin: str = ORIGIN) -> Value:
    asked = challenge(access, "login-challenge", ORIGIN)
    return ask(access, "login", asked.id, *phone.sign(asked.challenge, origin=origin))


def test_a_code_lets_somebody_look_once(site: ConsoleWork, access: ConsoleAccess) -> None:
    code = access.phone_code("user 7, process 8: rossec console phone")
    assert ask(access, "redeem", code) is None
    with pytest.raises(PhoneCodeRefused):
        ask(access, "redeem", code)
    assert site.audit == [
        "makes a code for a phone, for user 7, process 8: rossec console phone",
        "a code from the terminal was used at the console, to look",
    ]


def test_a_code_adds_a_passkey_and_is_used_by_that(site: ConsoleWork, access: ConsoleAccess) -> None:
    phone, code = Passkey(), access.phone_code("a test")
    view = from_value(PhoneView, add(access, phone, "Ann's phone", code))
    assert (view.id, view.name, view.added_by, view.ended) == (phone.id, "Ann's phone", "", "")
    with pytest.raises(PhoneCodeRefused):
        ask(access, "redeem", code)
    (recorded,) = site.home.store().passkeys.active()
    assert (recorded.origin, recorded.rp_id, recorded.approval) == (ORIGIN, RP_ID, b"")
    assert site.audit[-1] == 'adds the phone "Ann\'s phone", by a code from the terminal'
    site.home.store().log.audit(site.home.anchor().public_key)


@pytest.mark.parametrize("wrong", ["code", "challenge", "origin", "name"])
def test_nothing_else_adds_a_passkey(site: ConsoleWork, access: ConsoleAccess, wrong: str) -> None:
    phone, code = Passkey(), access.phone_code("a test")
    asked = challenge(access, "new-passkey", ORIGIN, RP_ID)
    signed = bytes(32) if wrong == "challenge" else asked.challenge
    origin = "http://localhost:1" if wrong == "origin" else None
    given, name = ("x", "p") if wrong == "code" else (code, "" if wrong == "name" else "p")
    with pytest.raises((PhoneCodeRefused, ApprovalRefused)):
        ask(access, "add-passkey", asked.id, given, name, *phone.register(signed, origin=origin))
    assert site.home.store().passkeys.all() == []
    assert add(access, phone, "Ann's phone", code), "the code is as good as before"


def test_a_challenge_is_answered_once(access: ConsoleAccess) -> None:
    phone = Passkey()
    asked = challenge(access, "new-passkey", ORIGIN, RP_ID)
    answer = phone.register(asked.challenge)
    ask(access, "add-passkey", asked.id, access.phone_code("a test"), "Ann's", *answer)
    with pytest.raises(ApprovalRefused, match="answered before"):
        ask(access, "add-passkey", asked.id, access.phone_code("a test"), "Ben's", *answer)


def test_where_the_audit_cannot_be_written_nothing_is_added(
    site: ConsoleWork, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(text: str) -> None:
        if "adds the phone" in text:
            raise KeyServiceRefused("the audit cannot be written")

    access = ConsoleAccess(site.work, full, site.elapsed)
    code = access.phone_code("a test")
    with pytest.raises(KeyServiceRefused):
        add(access, Passkey(), "Ann's phone", code)
    assert site.home.store().passkeys.all() == []
    ask(access, "redeem", code)


def test_a_second_phone_of_one_name_is_refused_and_the_code_stays(access: ConsoleAccess) -> None:
    add(access, Passkey(), "Ann's phone")
    code = access.phone_code("a test")
    with pytest.raises(StoreError, match="there is a passkey called"):
        add(access, Passkey(), "Ann's phone", code)
    assert add(access, Passkey(), "Ben's phone", code)


def test_a_phone_logs_in(site: ConsoleWork, access: ConsoleAccess) -> None:
    with pytest.raises(ApprovalRefused, match="no phone was registered at"):
        ask(access, "login-challenge", ORIGIN)
    phone = Passkey()
    add(access, phone, "Ann's phone")
    site.wait(60)
    assert access.last_used(phone.id) == access.counter(phone.id) == 0
    assert login(access, phone) == "Ann's phone"
    assert (access.last_used(phone.id), access.counter(phone.id)) == (site.now, phone.count)
    assert site.audit[-1] == 'the phone "Ann\'s phone" logged in at the console'


def test_a_login_is_for_its_challenge_and_page(access: ConsoleAccess) -> None:
    phone = Passkey()
    add(access, phone, "Ann's phone")
    asked = challenge(access, "login-challenge", ORIGIN)
    signed = phone.sign(asked.challenge)
    assert ask(access, "login", asked.id, *signed)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        ask(access, "login", asked.id, *signed)
    asked = challenge(access, "login-challenge", ORIGIN)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        ask(access, "login", asked.id, *signed)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_ORIGIN):
        login(access, phone, origin="http://localhost:1")
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        ask(access, "login-challenge", "http://localhost:1")


def test_a_removed_phone_or_another_key_does_not_log_in(site: ConsoleWork, access: ConsoleAccess) -> None:
    phone, kept = Passkey(), Passkey()
    add(access, phone, "Ann's phone")
    add(access, kept, "Ben's phone")
    asked = challenge(access, "login-challenge", ORIGIN)
    forged = Assertion(kept.id, *phone.sign(asked.challenge)[1:])
    with pytest.raises(ApprovalRefused, match=refusal_texts.ASSERTION_FORGED):
        ask(access, "login", asked.id, *forged)
    site.home.store().remove_passkey(phone.id, "lost", site.now)
    with pytest.raises(ApprovalRefused, match="was removed"):
        login(access, phone)


def test_a_copy_of_a_phone_is_noticed_at_its_login(access: ConsoleAccess) -> None:
    phone = Passkey()
    add(access, phone, "Ann's phone")
    copy = phone.clone()
    login(access, phone)
    login(access, phone)
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_CLONED):
        login(access, copy)


def test_phones_are_of_one_page_until_all_are_removed(site: ConsoleWork, access: ConsoleAccess) -> None:
    phone = Passkey()
    add(access, phone, "Ann's phone")
    other = Passkey("ca.example.org", "https://ca.example.org")
    with pytest.raises(ApprovalRefused, match="the phones here belong to http://localhost:7411"):
        add(access, other, "Ben's phone")
    with pytest.raises(ApprovalRefused, match="no passkeys of"):
        challenge(access, "new-passkey", "https://ca.example.org", "localhost")
    site.home.store().remove_passkey(phone.id, "renamed", site.now)
    assert add(access, other, "Ben's phone")


def test_two_first_phones_of_two_pages_do_not_both_come_in(access: ConsoleAccess) -> None:
    one, other = Passkey(), Passkey("ca.example.org", "https://ca.example.org")
    asked = [challenge(access, "new-passkey", each.origin, each.rp_id) for each in (one, other)]
    codes = [access.phone_code("a test") for _ in asked]
    ask(access, "add-passkey", asked[0].id, codes[0], "one", *one.register(asked[0].challenge))
    answer = other.register(asked[1].challenge)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_ORIGIN):
        ask(access, "add-passkey", asked[1].id, codes[1], "other", *answer)


def test_a_proposal_whose_digits_differ_is_refused(access: ConsoleAccess) -> None:
    link = ask(access, "phone-link")
    assert isinstance(link, str)
    proposal = from_value(Proposal, add(access, Passkey(), "Ben's", link, "propose-passkey"))
    ask(access, "end-proposal", proposal.id)
    assert ask(access, "proposals") == []
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        access.proposed.get(proposal.id)
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        ask(access, "end-proposal", proposal.id)


def test_a_phone_there_is_proposes_and_adds_nothing(site: ConsoleWork, access: ConsoleAccess) -> None:
    link = ask(access, "phone-link")
    assert isinstance(link, str)
    phone = Passkey()
    with pytest.raises(PhoneCodeRefused):
        add(access, phone, "Ben's phone", link)
    with pytest.raises(PhoneCodeRefused):
        ask(access, "redeem", link)
    proposal = from_value(Proposal, add(access, phone, "Ben's phone", link, "propose-passkey"))
    assert many(Proposal, ask(access, "proposals")) == (proposal,)
    assert access.proposed.get(proposal.id).id == phone.id
    assert site.home.store().passkeys.all() == [], "until another phone approves it"
    with pytest.raises(PhoneCodeRefused):
        add(access, phone, "Ben's phone", link, "propose-passkey")
    assert site.audit[-1] == 'the phone "Ben\'s phone" asks at the console to be added'


def test_without_the_extra_looking_works_and_adding_is_refused(
    access: ConsoleAccess, monkeypatch: pytest.MonkeyPatch
) -> None:
    phone = Passkey()
    add(access, phone, "Ann's phone")
    monkeypatch.setitem(sys.modules, "fido2", None)
    assert login(access, phone) == "Ann's phone"
    with pytest.raises(ApprovalRefused, match=refusal_texts.CONSOLE_EXTRA_MISSING) as caught:
        add(access, Passkey(), "Ben's phone")
    assert "rossec[console]" in caught.value.hint
