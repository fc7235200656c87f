"""The report: every field, every receiver."""

from grants.filters.layout import Layout, parse
from grants.model import Restriction, filter_rules
from grants.policy.privacy import ReceiverAccess
from rossec.console.matrix import Heard, held_accesses, topics
from rossec.console.words import day
from rossec.participant.message_types import message_type
from tests.support.consolehome import COARSE, NOW, POSE, demo, sees


def layout_of(name: str) -> Layout:
    return parse(name, message_type(name).definition)


def test_the_report_of_the_demo() -> None:
    home = demo()
    types = {fact.name: fact.node for fact in home.facts if fact.kind == "type"}
    found = topics(held_accesses(home.held, types), layout_of)
    assert [(each.topic, each.type) for each in found] == [
        ("/robot/pose", POSE),
        ("/robot/scan", "sensor_msgs/LaserScan"),
    ]
    doctor, heating = found[0].groups
    assert [who.name for who in doctor.receivers] == ["/doctor"]
    assert [(line.treatment, line.is_open) for line in doctor.fields] == [("as it is", True)]
    assert {line.treatment: line.fields for line in heating.fields} == {
        "as it is": ("header.seq", "header.stamp"),
        "removed": ("header.frame_id", *(f"pose.orientation.{axis}" for axis in "xyzw")),
        "position to 2 m": tuple(f"pose.position.{axis}" for axis in "xyz"),
    }
    (who,) = heating.receivers
    assert heating.sees == (
        "where it is: in steps of 2 m, and finer while it moves; how it moves: only by where it is"
    )
    assert doctor.sees == "where it is: exactly; how it moves: exactly"
    assert who.why == "decided by hand"
    assert who.until == day(NOW + 23 * 3600), "as all other times: of this host"
    assert who.by.startswith("grant ")


def test_who_is_treated_alike_stands_together() -> None:
    accesses = [ReceiverAccess("/t", POSE, name, "why", "7d", "rule", (COARSE,)) for name in ("/b", "/a")]
    (topic,) = topics([*accesses, ReceiverAccess("/t", POSE, "/c", "", "7d")], layout_of)
    assert [[who.name for who in group.receivers] for group in topic.groups] == [["/a", "/b"], ["/c"]]


def test_conditions_and_rates_are_said() -> None:
    limited = Restriction(None, ("now < 5",), (), 0.5)
    access = ReceiverAccess("/t", None, "/a", "", "7d", "", (limited,), 0.5)
    (topic,) = topics([access], layout_of)
    assert topic.groups[0].when == "now < 5 and at most one every 2 s"
    assert topic.type == ""
    assert topic.groups[0].fields[0].fields == ("everything in it",)


def test_a_filter_of_an_unknown_type_is_not_said_to_show_everything() -> None:
    hidden = Restriction("my_msgs/Own", (), filter_rules({"a": {"clear": True}}))
    (topic,) = topics([ReceiverAccess("/t", "my_msgs/Own", "/a", "", "", "", (hidden,))], layout_of)
    assert [(line.treatment, line.fields) for line in topic.groups[0].fields] == [
        ("as it is", ("everything else in it",)),
        ("removed", ("a",)),
    ]
    assert topic.groups[0].sees == ""


def test_only_what_is_wanted_is_in_it() -> None:
    access = ReceiverAccess("/t", POSE, "/a", "", "")
    (topic,) = topics([access], layout_of, lambda _, field: field.endswith(".x"))
    (line,) = topic.groups[0].fields
    assert line.fields == ("pose.position.x", "pose.orientation.x")
    assert topics([access], layout_of, lambda who, _: who == "/b") == []


def test_what_is_ending_is_in_it() -> None:
    home = demo()
    home.heard = Heard()
    (access,) = [each for each in held_accesses(home.held, {}) if each.topic == "/robot/camera"]
    assert (access.receiver, access.until) == ("/doctor", "every node has heard")
    assert access.why == "it was ended, and may still see it"


def test_a_topic_is_one_where_the_policy_or_one_grant_knows_its_type() -> None:
    home = demo()
    topic, *others = topics(held_accesses(home.held, {}), layout_of)
    assert (topic.topic, topic.type, len(topic.groups)) == ("/robot/pose", POSE, 2)
    assert [each.type for each in others] == [""]
    types = {"/robot/scan": "sensor_msgs/LaserScan"}
    found = topics(held_accesses(home.held, {}, lambda name: types.get(name, "")), layout_of)
    assert [each.type for each in found] == [POSE, "sensor_msgs/LaserScan"]


def test_what_ended_is_not_in_it_and_rules_are_named() -> None:
    home = demo()
    home.grants = [home.grants[2], home.grants[3]._replace(rules="heating-room")]
    (access,) = held_accesses(home.held, {})
    assert (access.receiver, access.why) == ("/heating", "rule heating-room of the policy")
    assert access.type == POSE
    home.grant("/doctor", sees("/other"))
    assert {each.type for each in held_accesses(home.held, {})} == {POSE, None}
