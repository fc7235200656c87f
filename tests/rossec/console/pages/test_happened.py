"""The time line, and the way it goes."""

import re

from rossec.authority.console.messages import EventView
from rossec.errors import KeyServiceRefused
from tests.support.consolehome import NOW, FakeHome, as_service, crowd, demo
from tests.support.consolepages import Browser


def page(home: FakeHome | None = None) -> Browser:
    made = Browser(as_service(home or demo()))
    made.now = NOW
    return made.log_in()


def long_home() -> FakeHome:
    home = demo()
    home.events = [
        EventView(number, NOW - 1000 * (300 - number), "certificate", f"/node{number}", "")
        for number in range(299, 0, -1)
    ]
    return home


def nodes(text: str) -> list[str]:
    return re.findall(r">(/node\d+)</bdi> <bdi>belongs", text)


def test_record_and_denials_are_one_line_of_time() -> None:
    text = page().get("/log").text
    assert text.index("without being allowed to") < text.index("may no longer")
    assert "belongs here now" in text


def test_a_long_record_is_read_part_by_part_without_gap_or_repetition() -> None:
    made = page(long_home())
    path, seen, denials = "/log", list[str](), 0
    while path:
        text = made.get(path).text
        seen += nodes(text)
        denials += text.count("without being allowed to")
        found = re.search(r'href="(/log\?before=[^"]+)"', text)
        path = found[1] if found else ""
    assert seen == [f"/node{number}" for number in range(299, 0, -1)]
    assert denials == 1


def test_one_node_is_found_far_back() -> None:
    text = page(long_home()).get("/log?node=/node7").text
    assert nodes(text) == ["/node7"]
    assert page().get("/log?node=<script>").status_code == 404
    assert page().get("/log?before=x").status_code == 404


def test_what_is_new_is_counted_for_each_session() -> None:
    made = page()
    assert "since you last looked" not in made.get("/log").text
    newest = made.home.events[-1]
    for more in (1, 2):
        made.home.events.append(newest._replace(number=newest.number + more, at=NOW))
    assert "2 things since you last looked" in made.get("/log").text
    assert "since you last looked" not in made.get("/log").text


def test_denials_beyond_a_number_are_counted_only() -> None:
    text = page(crowd()).get("/log").text
    assert text.count("without being allowed to") == 20
    assert "And 380 more refusals" in text


def test_the_way_shows_lines_and_says_them() -> None:
    text = page().get("/way").text
    for line in ("flow-all", "flow-coarse", "flow-ended", "badge"):
        assert f'class="{line}"' in text
    assert "nobody sees it" in text
    assert "without being allowed to" in text


def test_the_way_without_a_master_says_what_is_allowed() -> None:
    made = page()
    made.home.refusals["graph"] = KeyServiceRefused("no master answers")
    made.home.refusals["denials"] = KeyServiceRefused("no master answers")
    text = made.get("/way").text
    assert "The master does not answer" in text
    assert "Not known now" in text
    assert "flow-coarse" in text


def test_the_way_of_a_crowd_is_read_part_by_part() -> None:
    made = page(crowd())
    assert "topics 1 to 12 of 40" in made.get("/way").text
    assert "topics 37 to 40 of 40" in made.get("/way?row=36").text
