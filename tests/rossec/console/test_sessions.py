"""Sessions: found by their cookie, ended by time, bounded."""

import base64
import secrets

import pytest

from rossec.console.sessions import MAX_SESSIONS, Sessions

SECRET = bytes(range(32))


def sessions() -> Sessions:
    return Sessions(1000, 100)


def test_a_session_is_found_by_its_cookie_alone() -> None:
    found = sessions()
    cookie = found.begin(SECRET, "my phone", 10)
    assert base64.urlsafe_b64decode(cookie + "=") == SECRET
    session = found.find(cookie, 11)
    assert session is not None
    assert session.phone == "my phone"
    assert SECRET not in repr(session).encode()
    for other in ("", cookie[:-1], cookie + "A", "A" * 43, "é" * 43, "!" * 43, cookie[:-1] + "="):
        assert found.find(other, 11) is None


@pytest.mark.parametrize("later", [100, 1000, -1])
def test_it_ends_when_nobody_uses_it_or_a_clock_is_set_back(later: int) -> None:
    found = sessions()
    cookie = found.begin(SECRET, "", 10)
    assert found.find(cookie, 10 + later) is None
    assert found.find(cookie, 10) is None
    assert len(found) == 0


def test_use_makes_it_longer_but_not_for_ever() -> None:
    found = sessions()
    cookie = found.begin(SECRET, "", 0)
    for now in range(0, 1000, 99):
        session = found.find(cookie, now)
        assert session is not None
        session.used = now
    assert found.find(cookie, 1000) is None


def test_ending_one_ends_what_waits_on_it() -> None:
    found = sessions()
    session = found.find(found.begin(SECRET, "", 0), 0)
    assert session is not None
    found.end(session)
    assert not found.is_valid(session, 0)


def test_a_cookie_that_begins_anew_is_another_session() -> None:
    found = sessions()
    first = found.find(found.begin(SECRET, "", 0), 0)
    found.begin(SECRET, "", 1)
    assert first is not None
    assert not found.is_valid(first, 1)


def test_removing_a_phone_ends_its_sessions_alone() -> None:
    found = sessions()
    one, two, other = (found.begin(secrets.token_bytes(32), phone, 0) for phone in ("mine", "mine", "hers"))
    found.end_of_phone("mine")
    assert [found.find(cookie, 1) is None for cookie in (one, two, other)] == [True, True, False]


def test_the_oldest_makes_room() -> None:
    found = sessions()
    cookies = [found.begin(secrets.token_bytes(32), "", 0) for _ in range(MAX_SESSIONS + 1)]
    assert len(found) == MAX_SESSIONS
    assert found.find(cookies[0], 1) is None
    assert found.find(cookies[1], 1) is not None
