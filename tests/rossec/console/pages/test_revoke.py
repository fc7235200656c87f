"""Ending what was allowed: reason, ticks, and what asks for more."""

import pytest

from ca.approvals.passkeys import base64url
from rossec.authority.console.messages import ListProgress
from rossec.console.pages.decisions import REFRESH
from rossec.console.server.control import WebSettings
from tests.support.consolepages import ORIGIN, Browser


def grant_of(browser: Browser) -> str:
    return base64url(browser.home.grants[1].id)


def test_a_grant_is_ended_with_a_reason() -> None:
    browser = Browser().log_in("")
    path = f"/revoke/grant/{grant_of(browser)}"
    text = browser.get(path).text
    assert "/doctor" in text
    assert "/robot/pose" in text
    assert f'method="post" action="{path}"' in text
    assert 'name="name"' not in text
    answer = browser.post(path, data={"reason": "the visit is over"})
    seq = browser.home.number
    assert answer.status_code == 303
    assert answer.headers["location"] == f"/revoked/1/{seq}?grant={grant_of(browser)}"
    assert browser.asked("revoke-grant") == [(browser.home.grants[1].id, "the visit is over")]


def test_a_whole_node_asks_for_its_name() -> None:
    browser = Browser().log_in("")
    assert 'name="name"' in browser.get("/revoke/node/robot").text
    wrong = browser.post("/revoke/node/robot", data={"reason": "", "name": "/Robot"})
    assert wrong.status_code == 422
    assert browser.asked("revoke-node") == []
    right = browser.post("/revoke/node/robot", data={"reason": "lost", "name": "/robot"})
    assert right.headers["location"].endswith("?node=%2Frobot")
    assert browser.asked("revoke-node") == [("/robot", "lost")]


@pytest.mark.parametrize("typed", ["robot", " /robot ", "robot "])
def test_a_name_without_its_slash_is_the_name(typed: str) -> None:
    browser = Browser().log_in("")
    browser.post("/revoke/node/robot", data={"reason": "", "name": typed})
    assert browser.asked("revoke-node") == [("/robot", "")]


def test_what_is_wrong_is_said_where_it_was_typed_with_a_field_to_go_on() -> None:
    browser = Browser().log_in("")
    wrong = browser.post("/revoke/node/robot", data={"reason": "lost", "name": "robbie"})
    assert wrong.status_code == 422
    assert "You typed &#39;robbie&#39;, the name is /robot" in wrong.text
    assert 'action="/revoke/node/robot"' in wrong.text
    assert 'value="lost"' in wrong.text
    assert 'value="robbie"' in wrong.text
    path = f"/revoke/grant/{grant_of(browser)}"
    wrong = browser.post(path, data={"reason": "a\nb"})
    assert wrong.status_code == 422
    assert f'action="{path}"' in wrong.text
    assert "one line" in wrong.text
    assert browser.asked("revoke-grant") == browser.asked("revoke-node") == []


@pytest.mark.parametrize("name", ["/master", "/master/kitchen"])
def test_a_master_asks_for_the_passkey(name: str) -> None:
    browser = Browser().log_in()
    browser.home.nodes.append(browser.home.nodes[0]._replace(name=name))
    text = browser.get(f"/revoke/node{name}").text
    assert 'action="/prepare/revoke-master" data-approve' in text
    assert f'name="master" value="{name}"' in text
    assert 'class="card alarm"' in text


@pytest.mark.parametrize(
    ("path", "form", "status"),
    [
        ("/revoke/grant/AAAA", {"reason": "", "more": "1"}, 422),
        ("/revoke/grant/AAAA", {}, 422),
        ("/revoke/node/robot", {"reason": ""}, 422),
        ("/revoke/node/nobody", {"reason": "", "name": "/nobody"}, 404),
    ],
)
def test_another_form_ends_nothing(path: str, form: dict[str, str], status: int) -> None:
    browser = Browser().log_in()
    assert browser.post(path, data=form).status_code == status
    assert browser.asked("revoke-grant") == browser.asked("revoke-node") == []


@pytest.mark.parametrize(
    ("trust_status", "ticks", "says"),
    [
        (ListProgress(1, 4, False, False, 0, 0), 0, "may still"),
        (ListProgress(1, 4, True, False, 0, 0), 1, "may still"),
        (ListProgress(1, 4, True, True, 3, 2), 2, "may still"),
        (ListProgress(1, 4, True, True, 0, 0), 2, "may still"),
        (ListProgress(1, 4, True, True, 3, 3), 3, "may no longer"),
    ],
)
def test_the_ticks_come_as_they_are_true(trust_status: ListProgress, ticks: int, says: str) -> None:
    browser = Browser().log_in()
    browser.home.trust_status = trust_status
    answer = browser.get(f"/revoked/1/4?grant={grant_of(browser)}")
    assert answer.text.count("is-done") == ticks
    assert says in answer.text
    assert answer.headers.get("refresh") == (None if ticks == 3 else str(REFRESH))
    # The third tick is remembered, of all that was ended before.
    assert browser.asked("trust-status") == [(1, 4)] + [(0, 0)] * (ticks == 3)
    if trust_status.nodes:
        assert f"{trust_status.nodes_with_list} of 3 nodes have it" in answer.text


def test_while_the_key_is_locked_it_waits_to_be_signed() -> None:
    browser = Browser().log_in()
    browser.home.remaining = None
    browser.home.trust_status = ListProgress(0, 0, False, False, 0, 0)
    answer = browser.post("/revoke/node/robot", data={"reason": "", "name": "/robot"})
    assert answer.headers["location"] == "/revoked/0/0?node=%2Frobot"
    text = browser.get(answer.headers["location"]).text
    assert "is still trusted" in text
    assert "rossec ca unlock" in text
    assert "is-done" not in text
    browser.home.remaining = 600
    browser.home.trust_status = ListProgress(1, 5, True, True, 3, 3)
    assert "is no longer trusted" in browser.get("/revoked/0/0?node=/robot").text


@pytest.mark.parametrize(
    "path",
    [
        "/revoke/grant/AAAA",
        "/revoke/node/nobody",
        "/revoked/1/4?grant=AAAA",
        "/revoked/1/4?node=/nobody",
        "/revoked/-1/4",
        "/revoked/1/99999999999999999",
    ],
)
def test_what_is_not_there_is_told(path: str) -> None:
    assert Browser().log_in().get(path).status_code == 404


def test_without_a_subject_only_the_ticks_are_shown() -> None:
    assert "It has ended" in Browser().log_in().get("/revoked/1/4").text


def test_a_screen_that_only_shows_offers_nothing() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), read_only=True)).log_in()
    assert "<form" not in browser.get(f"/revoke/grant/{grant_of(browser)}").text
