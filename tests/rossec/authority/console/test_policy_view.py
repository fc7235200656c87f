"""The policy compared with what is in force, or its mistakes."""

import hashlib
from pathlib import Path

import pytest

from grants.model import Right
from rossec.authority.console.messages import PolicyRight, PolicyView, from_value
from rossec.authority.console.queries import PolicyQuery
from tests.support.consolework import ConsoleWork, ask

POLICY = """rossec: 1
robot: r
rules:
  - {id: a, who: /heating, allow: {subscribe: [/temperature, /pose]}, lifetime: 1w}
"""


@pytest.fixture
def site(tmp_path: Path) -> ConsoleWork:
    return ConsoleWork(tmp_path)


def look(site: ConsoleWork) -> PolicyView:
    return from_value(PolicyView, ask(PolicyQuery(site.work), "policy"))


def test_without_a_file_there_is_no_digest(site: ConsoleWork) -> None:
    view = look(site)
    assert view == PolicyView(str(site.work.policy_path()), b"", (), (), 0, ())


def test_what_it_gives_takes_and_keeps(site: ConsoleWork) -> None:
    path = site.work.policy_path()
    path.write_text(POLICY)
    site.enroll("/heating")
    view = look(site)
    assert view.digest == hashlib.sha256(POLICY.encode()).digest()
    assert sorted(view.gives) == [
        PolicyRight("/heating", int(Right.SUBSCRIBE), "/pose", "", "7d"),
        PolicyRight("/heating", int(Right.SUBSCRIBE), "/temperature", "", "7d"),
    ]
    site.unlock()
    site.work.grant_outright(["/heating"])
    view = look(site)
    assert (view.gives, view.takes, view.keeps) == ((), (), 2)
    path.write_text(POLICY.replace(", /pose", ""))
    view = look(site)
    assert (view.gives, view.keeps) == ((), 1)
    assert view.takes == (PolicyRight("/heating", int(Right.SUBSCRIBE), "/pose", "", ""),)


def test_mistakes_are_shown_with_the_digest_of_the_file(site: ConsoleWork) -> None:
    text = "rossec: 1\nrobot: r\nrules: [{id: a}, {id: a}]\n"
    site.work.policy_path().write_text(text)
    view = look(site)
    assert view.digest == hashlib.sha256(text.encode()).digest()
    assert view.gives == ()
    assert len(view.mistakes) > 1
    site.work.policy_path().write_bytes(b"\xff")
    assert "is not UTF-8" in look(site).mistakes[0]


def test_a_file_that_others_write_is_a_mistake(site: ConsoleWork) -> None:
    site.work.policy_path().write_text(POLICY)
    site.work.policy_path().chmod(0o666)
    assert len(look(site).mistakes) == 1
