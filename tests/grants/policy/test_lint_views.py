"""What each receiver sees: samples, topics, and what filters leave of a field."""

import pytest

from grants.model import FilterRule
from grants.policy.lint_views import Aspect, LintedPolicy, Precision, View, receivers, too_fine, too_small
from grants.policy.model import SubjectPattern
from tests.grants.policy.lint_cases import layout_of, text_of
from tests.grants.policy.lint_leaks import COARSE, KEY, filtered, pose
from tests.grants.policy.policies import policy


def linted(*lines: str, head: str = "", types: dict[str, str] | None = None) -> LintedPolicy:
    return LintedPolicy(policy(text_of(*lines, head=head, types=types)), layout_of)


def view(*lines: str, topic: str = "/pose") -> View:
    [views] = linted(*lines).views.values()
    return next(each for each in views if each.topic == topic)


def test_a_sample_for_each_subject() -> None:
    of = policy(
        text_of("id: a, who: [/x, '/y/**', '*'], allow: {call: /b}", "id: n, who: /no, deny: {call: /b}")
    )
    assert [each.subject.name for each in receivers(of)] == ["/x", "/y/x"]
    assert SubjectPattern("i", None, bytes(range(32))).sample.key == bytes(range(32))


def test_a_sample_for_each_key_that_is_pinned() -> None:
    head = f"identities: {{i: {{node: '/*', key: '{KEY}'}}}}\n"
    found = linted("id: a, who: [/y, i], allow: {call: /b}", head=head).views
    assert {(each.subject.name, any(each.subject.key)) for each in found} == {
        ("/y", False),
        ("/y", True),
        ("/x", True),
    }


def test_topics_below_a_pattern() -> None:
    [views] = linted(
        "id: a, who: /x, allow: {subscribe: ['/**']}", types={"/my/pose": "geometry_msgs/Pose"}
    ).views.values()
    topics = {each.topic: each for each in views}
    assert {"/**", "/tf", "/my/pose"} < topics.keys()
    assert topics["/tf"].is_below_pattern
    assert not topics["/**"].is_below_pattern


def test_own_names_are_those_of_the_sample() -> None:
    [views] = linted("id: a, who: '/r/*', allow: {subscribe: ['{node}/p']}").views.values()
    assert [each.topic for each in views] == ["/r/x/p"]


def test_what_is_denied_is_not_seen() -> None:
    lines = (COARSE, "id: d, who: '*', deny: {subscribe: [/pose]}")
    assert list(linted(*lines).views.values()) == [[]]


def test_what_is_left_of_fields() -> None:
    seen = view(COARSE)
    assert seen.left("pose.position.x") is Precision.COARSE
    assert seen.left("pose.orientation.w") is Precision.HIDDEN
    assert seen.left("header.frame_id") is Precision.EXACT
    assert seen.coarse(Aspect.POSITION) == ["pose.position.x", "pose.position.y", "pose.position.z"]
    assert seen.filter_on("pose.position.y").operator == "round"
    assert seen.rule.id == "coarse"
    assert seen.place(seen.filters[0])[0].id == "coarse"
    assert (seen.verdict.rate is not None, seen.has_slot, seen.is_empty) == (True, False, False)


def test_the_strictest_of_all_rules_counts() -> None:
    seen = view(COARSE, filtered("/pose", "pose: {clear: true}"))
    assert seen.left("pose.position.x") is Precision.HIDDEN
    assert view(filtered("/pose", "pose: {clear: true}, header: {clear: true}")).is_empty


@pytest.mark.parametrize("treatment", ["{clamp: [0, 5]}", "{round: 0.001}", "{clamp: {low: -1, high: 1}}"])
def test_what_leaves_a_value_as_it_is(treatment: str) -> None:
    assert view(pose(treatment)).left("pose.position.x") is Precision.EXACT
    assert view(pose(treatment)).shows(Aspect.POSITION)


def test_order_and_length_of_arrays() -> None:
    sort = view(filtered("/diagnostics", "status: {sort: true}"), topic="/diagnostics")
    assert sort.left("status[*].name") is Precision.EXACT
    kept = view(filtered("/words", "data: {truncate: 3}"), topic="/words")
    assert kept.left("data") is Precision.EXACT
    gone = view(filtered("/words", "data: {truncate: 0}"), topic="/words")
    assert gone.left("data") is Precision.HIDDEN


def test_a_topic_without_a_type_shows_what_its_name_says() -> None:
    seen = view("id: a, who: /x, allow: {subscribe: [/robot/odom]}", topic="/robot/odom")
    assert seen.shows(Aspect.POSITION)
    assert not seen.shows(Aspect.IMAGE)
    assert seen.is_known
    assert (seen.aspects, seen.filters, seen.is_empty) == ({}, (), False)


def test_floors() -> None:
    for small in ({"block": 31}, {"across": 21}, {"across": 21, "block": 31}):
        assert too_small(FilterRule("data", "pixelate", tuple(small.items())))
    for large in ({"block": 32}, {"across": 20}, {"across": 20, "block": 2}):
        assert not too_small(FilterRule("data", "pixelate", tuple(large.items())))
    step = FilterRule("p", "round", (("step", 0.01),))
    assert too_fine(step, Aspect.POSITION, "p.x")
    assert not too_fine(step, Aspect.POSITION, "latitude")
    assert not too_fine(step, Aspect.NOTHING, "p")
