"""SROS2's XML: supported parts become rules, others are reported, attacks are refused."""

import pytest

from grants.errors import PolicyRefused
from grants.policy import sros2
from grants.policy.sros2 import import_sros2
from tests.grants.policy.policies import policy

TALKER = """<policy version="0.2.0"><enclaves><enclave path="/"><profiles>
<profile ns="/robot" node="talker">
  <topics publish="ALLOW"><topic>chatter</topic><topic>/abs</topic><topic>~/own</topic>
    <topic>chatter</topic></topics>
  <topics subscribe="DENY"><topic>/camera/*</topic></topics>
  <topics subscribe="ALLOW"><topic>rt*</topic><topic>/parameter_events</topic></topics>
  <services reply="ALLOW"><service>/add</service></services>
  <services request="ALLOW"><service>/sub</service></services>
  <actions execute="ALLOW"><action>fib</action></actions>
  <actions call="MAYBE"><action>fob</action></actions>
</profile>
<profile ns="/" node="not a node"><topics publish="ALLOW"><topic>a</topic></topics></profile>
<profile ns="/robot" node="talker"><actions call="ALLOW"><action>/go</action></actions></profile>
</profiles></enclave></enclaves>
<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="/etc/passwd"/></policy>"""


def test_an_sros2_policy_is_imported() -> None:
    text, notes = import_sros2(TALKER)
    allow, deny, again = policy(text).rules
    assert [(item.right.label, item.pattern) for item in allow.clauses] == [
        ("publish", "/robot/chatter"), ("publish", "/abs"), ("publish", "{node}/own"),
        ("publish", "/robot/fib/status"), ("publish", "/robot/fib/feedback"),
        ("publish", "/robot/fib/result"), ("provide", "/add"), ("call", "/sub"),
        ("subscribe", "/robot/fib/goal"), ("subscribe", "/robot/fib/cancel"),
    ]  # fmt: skip
    assert (allow.subjects_text, str(deny.effect), deny.clauses[0].pattern) == (
        "/robot/talker", "deny", "/camera/*",
    )  # fmt: skip
    assert (again.id, again.clauses[0].right.label) == ("sros2-robot-talker-2", "publish")
    assert notes == [
        "/robot/talker: subscribe /robot/rt* is not a pattern of whole segments",
        "/robot/talker: /parameter_events exists in ROS 2 only",
        "profile /not a node: not a node name or pattern",
        "{http://www.w3.org/2001/XInclude}include is not followed",
    ]


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ("<policy>", "not XML"),
        ("", "not XML"),
        ("<other/>", "not an SROS2 policy but 'other'"),
        ("<policy/>", "no profile in this policy has rules"),
        ('<!DOCTYPE p [<!ENTITY a "b">]><policy>&a;</policy>', "a policy with a DTD is refused"),
        ('<!DOCTYPE p SYSTEM "http://x/y"><policy/>', "a policy with a DTD is refused"),
        ("\x00", "not XML"),
    ],
)
def test_invalid_and_dangerous_xml_is_refused(xml: str, message: str) -> None:
    with pytest.raises(PolicyRefused, match=message):
        import_sros2(xml)


def test_a_large_file_is_refused_before_it_is_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sros2, "iterparse", None)
    with pytest.raises(PolicyRefused, match="where at most"):
        import_sros2(" " * (sros2.MAX_SIZE + 1))


@pytest.mark.parametrize(
    "xml",
    [
        "<policy>" + "<a/>" * 30_000 + "</policy>",
        "<policy>" + "<a>" * 100 + "</a>" * 100 + "</policy>",
        "<policy " + " ".join(f"a{number}=''" for number in range(30_000)) + "/>",
    ],
    ids=["wide", "deep", "attributes"],
)
def test_too_many_elements_and_attributes_are_refused(xml: str) -> None:
    with pytest.raises(PolicyRefused, match="more than 20000 elements and attributes"):
        import_sros2(xml)


def test_repeated_nodes_have_separate_rules() -> None:
    one = '<profile ns="/" node="a"><topics publish="ALLOW"><topic>x</topic></topics></profile>'
    other = one.replace('"a"', '"a-2"').replace("a-2", "a_2")
    text, _ = import_sros2(f"<policy>{one}{other}{one}{one}</policy>")
    ids = [rule.id for rule in policy(text).rules]
    assert ids == ["sros2-a", "sros2-a_2", "sros2-a-2", "sros2-a-3"]
