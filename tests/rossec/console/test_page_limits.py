"""Every page of views is below its limit in a large home, and shows hostile texts as texts."""

import re
from html import unescape

import pytest

from ca.approvals.passkeys import base64url
from ca.encoding import encode
from rossec.authority.console.messages import AskedRight, DenialView, EventView, GrantQuestion
from tests.support.consolehome import HOSTILE, NOW, FakeHome, as_service, crowd, demo, key_of, sees
from tests.support.consolepages import Browser

LIMIT = 100_000
LONG = "/n" + "x" * 198
PATHS = sorted(["/", "/who", "/way", "/log", "/privacy", "/see{topic}", "/node{node}", "/grant/{grant}"])


def get(home: FakeHome, path: str, **names: str) -> str:
    made = Browser(as_service(home))
    made.now = NOW
    answer = made.log_in().get(path.format(**names))
    assert answer.status_code == 200
    return str(answer.text)


@pytest.mark.parametrize("path", PATHS)
def test_a_page_of_thirty_nodes_and_forty_topics_is_below_its_limit(path: str) -> None:
    home = crowd(30, 40)
    names = {"topic": "/robot/sensor_00/data", "node": "/a_robot_with_a_long_name"}
    text = get(home, path, grant=base64url(home.grants[0].id), **names)
    assert len(text.encode()) < LIMIT


@pytest.mark.parametrize("path", PATHS)
def test_a_page_of_long_names_is_below_its_limit(path: str) -> None:
    home = FakeHome()
    topics = [f"/t{at:02}{'y' * 196}" for at in range(40)]
    for at in range(30):
        name = f"/n{at:02}{'x' * 196}"
        home.node(name)
        home.grant(name, *(sees(topic) for topic in topics[at % 4 :: 4]))
    names = {"topic": topics[0], "node": home.nodes[0].name}
    text = get(home, path, grant=base64url(home.grants[0].id), **names)
    assert len(text.encode()) < LIMIT


def hostile() -> FakeHome:
    """The demo with everything that a node, a policy or a person can choose as `HOSTILE`."""
    home = demo()
    home.node(LONG)
    home.grant(LONG, sees(LONG))
    home.grant("/doctor", sees("/robot/scan"), revoked_at=NOW - 5, reason=HOSTILE)
    home.grants[3] = home.grants[3]._replace(rules=HOSTILE, delivery=HOSTILE)
    home.publisher("/robot/pose", HOSTILE, HOSTILE)
    home.publisher("/robot/other", "/robot", HOSTILE)
    home.nodes[2] = home.nodes[2]._replace(reason=HOSTILE, revoked_at=NOW - 9)
    home.denials.append(DenialView(NOW - 3, HOSTILE, 300, HOSTILE))
    for what in ("pending", "denied", "certificate", "decision", HOSTILE):
        home.events.insert(0, EventView(len(home.events), NOW, what, HOSTILE, HOSTILE))
    asked = AskedRight(2, "/robot/pose", HOSTILE, HOSTILE, HOSTILE, encode([]))
    home.questions.append(
        GrantQuestion(b"q" * 16, LONG, key_of(LONG), HOSTILE, NOW, NOW + 60, 60, (HOSTILE,), (asked,))
    )
    return home


@pytest.mark.parametrize("path", [*PATHS, "/log?node={node}", "/who?row=1&receiver=1"])
def test_a_hostile_text_is_text_on_every_page(path: str) -> None:
    home = hostile()
    for names in (
        {"topic": "/robot/pose", "node": "/heating", "grant": base64url(home.grants[3].id)},
        {"topic": LONG, "node": LONG, "grant": base64url(home.grants[4].id)},
    ):
        text = get(home, path, **names)
        scripts = re.findall(r"<script[^>]*>", text)
        assert all(re.fullmatch(r'<script type="module" src="[^"]+">', each) for each in scripts)
        assert "\u202e" not in unescape(text)
        assert " style=" not in text
        assert not re.search(r"<[^>]* on[a-z]+=", text)
        assert len(text.encode()) < LIMIT


def test_a_hostile_text_is_shown_somewhere() -> None:
    """What the test before looks for is really there."""
    assert "&lt;script&gt;" in get(hostile(), "/log")
    assert "\\u202e" in get(hostile(), "/")
