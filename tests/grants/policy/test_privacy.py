"""Each field, each receiver, how, why and until when; and a page that escapes every text."""

from grants.filters.layout import Layout, parse
from grants.model import FilterRule
from grants.policy.decision import Decider
from grants.policy.privacy import PrivacyRow, as_json, from_policy, leaf_paths, lines, rows
from grants.vocabulary.assess import filters_of
from tests.grants.policy.policies import definition, policy, rules


def layout(name: str) -> Layout:
    return parse(name, definition(name))


def found() -> list[PrivacyRow]:
    return rows(from_policy(Decider(policy())), layout)


def test_every_field_has_its_row() -> None:
    by_field = {row.field: row for row in found() if row.receiver == "/heating"}
    assert list(by_field) == sorted(leaf_paths(layout("geometry_msgs/PoseStamped")))
    assert by_field["header.stamp"].treatment == "as it is"
    assert by_field["pose.orientation.w"].treatment == "clear"
    x = by_field["pose.position.x"]
    assert (x.treatment, x.why, x.by) == ("round step 2.0", "Heating lowers rooms.", "rule heating-room")
    assert x.when.endswith('msg.header.frame_id == "map" and at most 0.2 messages a second')
    assert x.until == "7d at a time, renewed for 180d"
    assert as_json(found())[0]["topic"] == "/robot/pose"


def test_a_field_is_named_by_what_it_tells() -> None:
    by_field = {row.field: row for row in found() if row.receiver == "/heating"}
    assert by_field["pose.position.x"].tells == "position"
    assert by_field["pose.orientation.w"].tells == "movement"
    assert by_field["header.stamp"].tells == "presence"
    assert by_field["header.frame_id"].tells == "frame"
    assert by_field["header.seq"].sees == ("where it is: to 2 m; how it moves: only by where it is")


def test_a_report_speaks_the_vocabulary_of_the_policy() -> None:
    own = policy(
        "rossec: 1\nrobot: r\ntypes: {/door: std_msgs/Bool}\n"
        "vocabulary: {/door: {data: home}}\n"
        "rules: [{id: a, who: /x, allow: {subscribe: /door}}]\n"
    )
    (row,) = rows(from_policy(Decider(own)), layout, own.vocabulary)
    assert (row.tells, row.sees) == ("home", "the state of the home: exactly")
    (row,) = rows(from_policy(Decider(own)), layout)
    assert (row.tells, row.sees) == ("bare", "")


def test_denied_access_is_not_reported() -> None:
    of = rules(
        '{id: a, who: /x, allow: {subscribe: [/a, "/b/**"], publish: [/c]}}',
        "{id: b, who: /x, allow: {subscribe: [/a]}}",
        '{id: d, who: /x, deny: {subscribe: ["/b/secret"]}}',
    )
    (access,) = from_policy(Decider(of))
    (row,) = rows([access], layout)
    assert (row.topic, row.type, row.field) == ("/a", "type not known", "(everything)")
    assert (row.when, row.until) == ("always", "7d at a time")
    assert access.by == "rule a, b"


def test_two_treatments_of_one_field_are_both_reported() -> None:
    of = rules(
        "{id: a, who: /x, allow: {subscribe: /p}, filter: {pose: {clear: true}}}",
        "{id: b, who: /x, allow: {subscribe: /p}, filter: {pose.position.x: {round: 1}}}",
        head="rossec: 1\nrobot: r\ntypes: {/p: geometry_msgs/PoseStamped}\n",
    )
    (x,) = [
        row
        for row in rows(from_policy(Decider(of)), layout)
        if row.field.endswith("ion.x") and "position" in row.field
    ]
    assert sorted(x.treatment.split(", then ")) == ["clear", "round step 1"]


def test_a_filter_applies_to_nested_fields() -> None:
    rule = FilterRule("status[*].values", "drop")
    assert filters_of([rule], "status[*].values[*].key") == [rule]
    assert filters_of([rule], "status[*].value") == []
    assert "status[*].values[*].key" in leaf_paths(layout("diagnostic_msgs/DiagnosticArray"))


def test_leaf_paths_are_bounded() -> None:
    text = "\n".join(f"int8 f{n}" for n in range(600))
    assert len(leaf_paths(parse("a/B", text))) == 512
    nested = "X[] a\nX b\n" + "=" * 80 + "\nMSG: a/X\n" + text
    assert len(leaf_paths(parse("a/B", nested))) == 512


def test_a_rare_message_is_said_as_explain_says_it() -> None:
    seldom = rules(
        "{id: a, who: /x, allow: {subscribe: /p}, limit: {rate: 0.0333333}}",
        head="rossec: 1\nrobot: r\ntypes: {/p: std_msgs/String}\n",
    )
    (row,) = rows(from_policy(Decider(seldom)), layout)
    assert row.when == "at most one message every 30 s"


def test_the_report_as_text() -> None:
    report = lines(found())
    assert report[0] == "/robot/pose (geometry_msgs/PoseStamped) -> /heating"
    assert report[1] == "  sees where it is: to 2 m; how it moves: only by where it is"
    assert report[2] == "  why: Heating lowers rooms. (rule heating-room)"
    assert "  clear: pose.orientation.w, pose.orientation.x, pose.orientation.y, pose.orientation.z" in report
    assert "  why: no reason given (rule nav-full)" in report
    assert lines([]) == ["no receiver has access"]


def test_own_names_of_one_node_are_shown_with_its_name_those_of_many_as_written() -> None:
    own = rules(
        '{id: a, who: [/x, "/fleet/*"], allow: {subscribe: [~/state]}}',
        head='rossec: 1\nrobot: r\ntypes: {"~/state": std_msgs/String}\n',
    )
    found = {(row.topic, row.receiver): row.type for row in rows(from_policy(Decider(own)), layout)}
    assert found == {("/x/state", "/x"): "std_msgs/String", ("{node}/state", "/fleet/*"): "std_msgs/String"}
