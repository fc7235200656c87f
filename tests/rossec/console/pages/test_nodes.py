"""One node, one grant."""

from ca.approvals.passkeys import base64url
from rossec.console.matrix import TopicAccess
from rossec.console.pages.visibility import grant_line, sees
from tests.support.consolehome import NOW, FakeHome, as_service, crowd, demo
from tests.support.consolepages import Browser


def page(home: FakeHome | None = None) -> Browser:
    made = Browser(as_service(home or demo()))
    made.now = NOW
    return made.log_in()


def test_a_node_shows_what_it_sees_and_was_allowed() -> None:
    text = page().get("/node/doctor").text
    assert "Its identity is valid until" in text
    assert "/robot/pose" in text
    assert "ended 30 minutes ago" in text
    assert "the visit is over" in text
    assert "<s>" in text
    assert "What it sends" not in text


def test_a_publisher_shows_who_sees_what_it_sends() -> None:
    text = page().get("/node/robot").text
    assert "What it sends" in text
    assert "seen by" in text
    assert "nobody sees it" in text


def test_a_node_that_was_removed_says_so() -> None:
    home = demo()
    home.node("/thief", revoked_at=NOW - 3600, reason="stolen")
    text = page(home).get("/node/thief").text
    assert "Removed" in text
    assert "stolen" in text
    assert "Remove it" not in text


def test_an_unknown_node_is_no_page() -> None:
    assert page().get("/node/nobody").status_code == 404
    assert page().get("/node/%2e%2e").status_code in (404, 307)


def test_what_a_node_sees_now_comes_first() -> None:
    found = sees(demo().matrix, "/doctor")
    assert [cell.access for _, cell in found] == [TopicAccess.ALL, TopicAccess.ALL, TopicAccess.ENDED]


def test_a_grant_says_what_it_gives_and_how_it_ends() -> None:
    home = demo()
    coarse = home.grants[3]
    text = page(home).get(f"/grant/{base64url(coarse.id)}").text
    assert "position to 2 m" in text
    assert "pose.position: round step 2.0" in text
    assert f'action="/revoke/grant/{base64url(coarse.id)}"' in text
    ended = page(home).get(f"/grant/{base64url(home.grants[2].id)}").text
    assert "the visit is over" in ended
    assert "/revoke" not in ended


def test_a_grant_that_is_not_there_is_no_page() -> None:
    assert page().get(f"/grant/{base64url(b'x' * 16)}").status_code == 404
    assert page().get("/grant/!").status_code in (400, 404)


def test_the_line_of_a_grant() -> None:
    home = demo()
    lines = {each.view.id: grant_line(each, NOW) for each in home.held}
    ended = lines[home.grants[2].id]
    assert (ended.ended, ended.term) == (True, "ended 30 minutes ago")
    assert lines[home.grants[3].id].term == "23 hours left"


def test_a_node_of_a_crowd_is_bounded() -> None:
    text = page(crowd()).get("/node/a_robot_with_a_long_name").text
    assert text.count("seen by") == 40
    assert len(text) < 100_000
