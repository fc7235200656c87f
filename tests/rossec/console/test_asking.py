"""A question in words: what is wanted, in which ways it can be given, for how long."""

import pytest

from grants.document import scope_of
from grants.model import Permission, Restriction, Right, filter_rules
from rossec.authority.console.messages import AskedRight, FactView, GrantQuestion, QuestionAnswer
from rossec.console import approvals, samples
from rossec.console.approvals import DAY
from rossec.console.samples import Recorded
from rossec.console.sentences import SentencePart
from tests.support.consolehome import COARSE, POSE


def right(pattern: str, kind: str = POSE, of: Right = Right.SUBSCRIBE) -> AskedRight:
    return AskedRight(int(of), pattern, kind, "", "", scope_of([Permission(pattern, of)]))


def question(*rights: AskedRight, lifetime: int = 7 * DAY) -> GrantQuestion:
    return GrantQuestion(b"q", "/heating", b"k", "", 0, 9, lifetime, (), rights)


def told(parts: tuple[SentencePart, ...]) -> str:
    return " ".join(part.text for part in parts)


SENDS = [FactView("publisher", "/pose", "/robot"), FactView("type", "/pose", POSE)]


@pytest.mark.parametrize(
    ("rights", "facts", "said"),
    [
        ((right("/pose"),), SENDS, "/heating wants to see where /robot is"),
        ((right("/pose"),), [], "/heating wants to see /pose"),
        (
            (right("/pose"),),
            [*SENDS, FactView("publisher", "/pose", "/other")],
            "/heating wants to see /pose",
        ),
        ((right("/pose", "std_msgs/String"),), SENDS, "/heating wants to see /pose"),
        (
            (right("/lift", "", Right.CALL), right("/led", "", Right.PUBLISH)),
            [],
            "/heating wants to use /lift and to send /led",
        ),
        (
            tuple(right(f"/t{number}") for number in range(6)),
            [],
            ("/heating wants to see /t0 and to see /t1 and to see /t2 and to see /t3 and 2 more things"),
        ),
    ],
)
def test_the_sentence(rights: tuple[AskedRight, ...], facts: list[FactView], said: str) -> None:
    assert told(approvals.sentence(question(*rights), facts)) == said


def test_a_way_says_what_the_node_would_get() -> None:
    plain = right("/pose")
    coarse = plain._replace(permissions=scope_of([Permission("/pose", Right.SUBSCRIBE, COARSE)]))
    narrow, whole = approvals.ways([("", [plain]), ("coarse", [coarse])])
    assert [told(line) for line in whole.lines] == ["see /pose (all of it)"]
    assert (whole.coarse, whole.label, whole.is_narrowest) == ("", "All of it, as it asks", False)
    (line,) = narrow.lines
    assert told(line).startswith("see /pose (position to 2 m")
    assert (narrow.coarse, narrow.is_narrowest) == ("coarse", True)


def test_the_narrowest_way_is_chosen_beforehand_whatever_it_is_called() -> None:
    plain = right("/pose")
    rough = Restriction(POSE, (), filter_rules({"pose.position": {"round": {"step": 0.5}}}))
    everything = {"header": {"clear": True}, "pose": {"clear": True}}
    nothing = Restriction(POSE, (), filter_rules(everything), slot=60)
    given = [("", [plain])] + [
        (name, [plain._replace(permissions=scope_of([Permission("/pose", Right.SUBSCRIBE, each)]))])
        for name, each in (("a", rough), ("presence-only", nothing), ("b", COARSE))
    ]
    found = approvals.ways(given)
    assert [each.coarse for each in found] == ["presence-only", "b", "a", ""]
    assert [each.is_narrowest for each in found] == [True, False, False, False]
    assert found[0].label == "Only that it is there"
    assert found[1].label == "Coarser: b"
    assert [each.coarse for each in approvals.ways(given, 2)] == ["presence-only", ""]
    (alone,) = approvals.ways([("", [plain])])
    assert alone.is_narrowest


def test_what_a_node_would_do_is_told_apart_from_what_it_would_see() -> None:
    see, drive = right("/camera"), right("/cmd_vel", "geometry_msgs/Twist", Right.PUBLISH)
    assert not approvals.acts([see])
    assert approvals.acts([drive])
    assert approvals.drives(drive._replace(type=""))
    assert not approvals.drives(see._replace(pattern="/cmd_vel"))
    assert told(approvals.sentence(question(drive), [])) == (
        "/heating wants to drive: send commands to /cmd_vel"
    )


@pytest.mark.parametrize(
    ("of", "coarse", "why"),
    [
        (right("/pose"), ("room",), ""),
        (right("/lift", "", Right.CALL), (), "something that it would do"),
        (right("/x", "", Right.PARAM_GET), (), "Only what is sent"),
        (right("/**", ""), (), "many topics at once"),
        (right("/camera", ""), (), "does not say of which type"),
        (right("/x", "my_msgs/Own"), (), "fits messages of my_msgs/Own"),
    ],
)
def test_why_there_is_no_coarser_choice_is_said(of: AskedRight, coarse: tuple[str, ...], why: str) -> None:
    assert why in approvals.why_no_coarser(question(of)._replace(coarse=coarse))
    assert bool(approvals.why_no_coarser(question(of)._replace(coarse=coarse))) is bool(why)


def test_an_answer_in_words() -> None:
    denied = QuestionAnswer("/lamp", int(Right.SUBSCRIBE), "/camera", "denied", "no", 1)
    assert told(approvals.answer(denied)) == "/lamp may not see /camera"
    assert told(approvals.answer(denied._replace(answer="granted"))) == "/lamp may see /camera"


def test_two_filters_that_do_the_same_have_one_picture() -> None:
    plain = right("/pose")
    coarse = plain._replace(permissions=scope_of([Permission("/pose", Right.SUBSCRIBE, COARSE)]))
    ways = [("", [plain]), ("coarse", [coarse]), ("room", [coarse])]
    (found,) = approvals.looks("/heating", ways)
    assert [name for name, _ in found.pictures] == ["", "coarse"]
    assert found.is_made_up


def test_what_cannot_be_drawn_has_no_picture() -> None:
    rights = [right("/**"), right("/x", "no/Such"), right("/x", ""), right("/y", of=Right.CALL)]
    assert approvals.looks("/heating", [("", rights)]) == []


def test_real_messages_are_drawn_where_there_are_some() -> None:
    class Preview:
        def recorded(self, topic: str) -> Recorded | None:
            found = samples.recorded(topic, POSE)
            return None if found is None else found._replace(is_made_up=False)

    (found,) = approvals.looks("/heating", [("", [right("/pose")])], Preview())
    assert not found.is_made_up


@pytest.mark.parametrize(
    ("lifetime", "possible"),
    [
        (3600, ["today", "open"]),
        (7 * DAY, ["today", "week", "open"]),
        (30 * DAY, ["today", "week", "month", "open"]),
    ],
)
def test_no_button_promises_more_than_the_policy(lifetime: int, possible: list[str]) -> None:
    found = approvals.durations(question(lifetime=lifetime), 1_800_000_000)
    assert [each.value for each in found] == ["today", "week", "month", "open"]
    assert [each.value for each in found if each.is_possible] == possible
    assert all("the policy" in each.detail for each in found if not each.is_possible)
