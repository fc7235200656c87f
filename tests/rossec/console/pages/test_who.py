"""The whole matrix, and one topic."""

from grants.model import Permission, Right
from rossec.console.pages.visibility import ROWS, other_rights
from tests.support.consolehome import NOW, FakeHome, as_service, crowd, demo, sees
from tests.support.consolepages import Browser


def page(home: FakeHome | None = None) -> Browser:
    made = Browser(as_service(home or demo()))
    made.now = NOW
    return made.log_in()


def test_the_matrix_links_to_grants_topics_and_nodes() -> None:
    text = page().get("/who").text
    assert 'href="/see/robot/pose"' in text
    assert 'href="/node/doctor"' in text
    assert text.count('href="/grant/') == 4
    assert 'class="pager"' not in text


def test_a_crowd_is_shown_part_by_part() -> None:
    made = page(crowd())
    first, second = made.get("/who").text, made.get(f"/who?row={ROWS}&receiver=4").text
    assert "topics 1 to 12 of 40" in first
    assert "receivers 5 to 8 of 29" in second
    assert "/robot/sensor_12/data" in second
    assert "/robot/sensor_00/data" not in second
    assert made.get("/who?row=x").status_code == 404
    assert "No node may see anything here" in made.get("/who?row=4000").text


def test_other_rights_are_listed() -> None:
    home = demo()
    home.grant("/doctor", Permission("/robot/**", Right.CALL | Right.PARAM_SET))
    assert [(each.node, each.what, each.pattern) for each in other_rights(home.held)] == [
        ("/doctor", "use and change the setting", "everything below /robot")
    ]
    assert "What else nodes may do" in page(home).get("/who").text
    assert other_rights(demo().held) == []


def test_a_topic_shows_each_receiver_and_what_it_looks_like() -> None:
    text = page().get("/see/robot/pose").text
    assert "What it looks like" in text
    assert "sees the exact place" in text
    assert "sees which square" in text
    assert text.index("/doctor") < text.index("/heating")


def test_a_topic_that_nobody_sees_and_a_pattern_have_no_picture() -> None:
    home = demo()
    home.node("/eye")
    home.grant("/eye", sees("/robot/**"), sees("/untyped"))
    made = page(home)
    assert "every topic of that name" in made.get("/see/robot/**").text
    assert "is not known here" in made.get("/see/untyped").text
    assert "Nobody sees it" in page().get("/see/robot/camera").text


def test_an_unknown_topic_is_no_page() -> None:
    made = page()
    assert made.get("/see/nothing").status_code == 404
    assert made.get("/see/%3Cscript%3E").status_code == 404
