"""Each field, each receiver, how, why and until when; and a page nothing can be smuggled into."""

from dataclasses import replace

from grants.filters.layout import Layout, parse
from grants.model import FilterRule
from grants.policy.decision import Decider
from grants.policy.privacy import (
    PrivacyRow,
    ReceiverAccess,
    as_json,
    from_policy,
    html,
    leaves,
    lines,
    rows,
    treats,
)
from tests.grants.policy.policies import definition, policy, rules


def layout(name: str) -> Layout:
    return parse(name, definition(name))


def found() -> list[PrivacyRow]:
    return rows(from_policy(Decider(policy())), layout)


def test_every_field_has_its_row() -> None:
    by_field = {row.field: row for row in found() if row.receiver == "/heating"}
    assert list(by_field) == sorted(leaves(layout("geometry_msgs/PoseStamped")))
    assert by_field["header.stamp"].treatment == "as it is"
    assert by_field["pose.orientation.w"].treatment == "clear"
    x = by_field["pose.position.x"]
    assert (x.treatment, x.why, x.by) == (
        "round step 2.0", "Heating lowers rooms.", "rule heating-room",
    )  # fmt: skip
    assert x.when.endswith('msg.header.frame_id == "map" and at most 0.2 a second')
    assert x.until == "7d at a time, renewed for 180d"
    assert as_json(found())[0]["topic"] == "/robot/pose"


def test_what_a_denial_takes_back_is_not_there() -> None:
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


def test_two_treatments_of_one_field_are_both_said() -> None:
    of = rules(
        "{id: a, who: /x, allow: {subscribe: /p}, filter: {pose: {clear: true}}}",
        "{id: b, who: /x, allow: {subscribe: /p}, filter: {pose.position.x: {round: 1}}}",
        head="rossec: 1\nrobot: r\ntypes: {/p: geometry_msgs/PoseStamped}\n",
    )
    (x,) = [row for row in rows(from_policy(Decider(of)), layout) if row.field.endswith("ion.x")
            and "position" in row.field]  # fmt: skip
    assert sorted(x.treatment.split(", then ")) == ["clear", "round step 1"]


def test_a_filter_treats_what_lies_in_its_field() -> None:
    rule = FilterRule("status[*].values", "drop")
    assert treats([rule], "status[*].values[*].key") == [rule]
    assert treats([rule], "status[*].value") == []
    assert "status[*].values[*].key" in leaves(layout("diagnostic_msgs/DiagnosticArray"))


def test_the_leaves_are_bounded() -> None:
    text = "\n".join(f"int8 f{n}" for n in range(600))
    assert len(leaves(parse("a/B", text))) == 512
    nested = "X[] a\nX b\n" + "=" * 80 + "\nMSG: a/X\n" + text
    assert len(leaves(parse("a/B", nested))) == 512


def test_in_words() -> None:
    said = lines(found())
    assert said[0] == "/robot/pose (geometry_msgs/PoseStamped) -> /heating"
    assert said[1] == "  why: Heating lowers rooms. (rule heating-room)"
    assert (
        "  clear: pose.orientation.w, pose.orientation.x, pose.orientation.y, "
        "pose.orientation.z" in said
    )
    assert "  why: no reason given (rule nav-full)" in said
    assert lines([]) == ["nobody sees anything"]


def test_the_page_escapes_every_text() -> None:
    evil = "<script>alert(1)</script>"
    (row,) = rows([ReceiverAccess("/a", None, "/x", evil, evil, evil)], layout)
    page = html([row, replace(row, topic="/b")], evil)
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 6
    assert 'class="open"' in page
    assert "Nobody sees anything" in html([], "t")
    assert "http" not in page.replace("http-equiv", "")
