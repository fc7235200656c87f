"""The first page."""

import pytest

from ca.approvals.passkeys import base64url
from ca.encoding import encode
from grants.model import Right
from rossec.authority.console.messages import AskedRight, GrantQuestion, IdentityRequestView, Proposal
from rossec.console.pages.today import TodayCounts, counts
from rossec.errors import KeyServiceRefused
from tests.support.consolehome import NOW, FakeHome, as_service, demo
from tests.support.consolepages import Browser


def page(home: FakeHome | None = None) -> Browser:
    made = Browser(as_service(home or demo()))
    made.now = NOW
    made.home.policy = made.home.policy._replace(gives=())  # all is as it says
    return made.log_in()


def test_nothing_waits_and_everything_is_shown() -> None:
    text = page().get("/").text
    assert "Nothing waits for you" in text
    assert "1 node sends 3 topics; 2 may look." in text
    for said in ("all of it", "coarse", "ended", "nothing", "23 hours left", "the visit is over"):
        assert said in text
    assert "position to 2 m, without direction, without the map&#39;s name" in text
    assert "Where is" in text
    assert "It depends who looks" in text
    assert "12 squares in this minute" in text
    assert "Made up." in text
    assert text.count("<svg") > 8
    assert "asked to see" in text
    assert "1 other node sees no topic" in text


def test_what_waits_comes_first_the_oldest_before_the_others() -> None:
    home = demo()
    asked = AskedRight(int(Right.SUBSCRIBE), "/robot/scan", "", "", "", encode([]))
    home.questions.append(
        GrantQuestion(
            b"\1" * 16, "/heating", b"k" * 32, "to be <b>warm</b>", NOW - 60, NOW + 60, 3600, (), (asked,)
        )
    )
    made = page(home)
    request = IdentityRequestView(
        b"\2" * 32, "/lamp", b"k" * 32, "code", NOW - 120, NOW + 60, "pending", False, False, b""
    )
    made.home.requests = [request, request._replace(name="/issued", state="approved")]
    made.home.proposals = [Proposal(b"\3" * 16, "Ben's phone", "123456", NOW + 60)]
    text = made.get("/").text
    assert "3 things wait for you" in text
    assert text.index("/lamp</bdi>") < text.index("asks to</bdi> <bdi>see") < text.index("Ben&#39;s")
    assert 'href="/ask/AQEBAQEBAQEBAQEBAQEBAQ"' in text
    assert "&lt;b&gt;warm&lt;/b&gt;" in text
    assert "/issued" not in text


def test_a_locked_key_no_phone_and_no_master_are_said() -> None:
    made = page()
    made.home.remaining, made.home.phones = None, []
    made.log_in("")  # by a code: no phone is set up
    made.home.refusals["graph"] = KeyServiceRefused("no master answers")
    text = made.get("/").text
    assert "key is locked" in text
    assert "No phone can approve yet" in text
    assert "The master does not answer" in text
    assert "you can approve, refuse and end as always" in text
    assert "no master answers" not in text, "an error is for the log"
    assert "Nothing waits for you" in text


def test_a_policy_that_has_changed_waits_for_an_answer() -> None:
    made = page()
    made.home.policy = made.home.policy._replace(mistakes=("line 3: no such filter",))
    text = made.get("/").text
    assert "One thing waits for you" in text
    assert "The policy has mistakes" in text
    assert 'href="/policy"' in text
    made.home.refusals["policy"] = KeyServiceRefused("it cannot be read")
    assert "Nothing waits for you" in made.get("/").text


def test_it_says_ending_until_every_node_has_heard() -> None:
    """Also while the master does not answer: then nobody knows who has."""
    made = page()
    made.home.trust_status = made.home.trust_status._replace(nodes_with_list=2)
    text = made.get("/").text
    assert 'class="is-ending"' in text
    assert "ended 30 minutes ago" in text
    assert "Ending" in text
    assert "Nobody else can" not in text
    assert 'data-again="5"' in text
    made.home.trust_status = made.home.trust_status._replace(nodes_with_list=3)
    text = made.get("/").text
    assert 'class="is-ended"' in text
    assert "Nobody else can" in text
    assert "data-again" not in text
    away = page()
    away.home.refusals["graph"] = KeyServiceRefused("no master answers")
    assert 'class="is-ending"' in away.get("/").text
    assert away.asked("trust-status") == [], "the page does not wait twice for a master that is away"
    made.home.refusals["graph"] = KeyServiceRefused("no master answers")
    assert 'class="is-ended"' in made.get("/").text, "it was heard before"
    told = page()
    told.get("/revoked/1/4?node=/doctor")
    told.home.refusals["graph"] = KeyServiceRefused("no master answers")
    assert 'class="is-ended"' in told.get("/").text, "the page of the three ticks said so"


@pytest.mark.parametrize("path", ["/who", "/see/robot/camera", "/node/doctor", "/way", "/privacy"])
def test_other_pages_say_ending_too(path: str) -> None:
    made = page()
    made.home.trust_status = made.home.trust_status._replace(nodes_with_list=2)
    text = made.get(path).text
    assert "every node has heard" in text or '<b class="ending">ending</b>' in text
    assert 'data-again="5"' in text


def test_a_grant_and_a_node_that_are_ending_say_so() -> None:
    home = demo()
    home.nodes[2] = home.nodes[2]._replace(revoked_at=NOW - 60, reason="sold")
    made = page(home)
    made.home.trust_status = made.home.trust_status._replace(is_at_master=False)
    grant = made.get(f"/grant/{base64url(home.grants[2].id)}").text
    assert "may do until every node has heard" in grant
    assert "might" not in grant
    assert "Being removed" in made.get("/node/heating").text
    made.home.trust_status = made.home.trust_status._replace(is_at_master=True)
    made.now += 1
    assert "was allowed</h1>" in made.get(f"/grant/{base64url(home.grants[2].id)}").text
    assert "Being removed" not in made.get("/node/heating").text


def test_a_new_home_has_a_page() -> None:
    text = page(FakeHome()).get("/").text
    assert "No node may see anything yet" in text
    assert "Nobody sends anything yet" in text
    assert "Nothing yet" in text


def test_what_is_new_since_the_log_was_looked_at_is_counted() -> None:
    made = page()
    assert "since you last looked" not in made.get("/").text
    made.get("/log")
    assert "since you last looked" not in made.get("/").text
    newest = made.home.events[-1]
    made.home.events.append(newest._replace(number=newest.number + 1, at=NOW, what="denied"))
    assert "1 new since you last looked" in made.get("/").text


def test_the_counts_are_of_topics_that_are_sent() -> None:
    assert counts(demo().matrix) == TodayCounts(1, 3, 2)


def test_it_needs_a_session() -> None:
    assert Browser(as_service(demo())).get("/").status_code == 303
