"""SROS2's XML: supported parts become rules, others are reported, attacks are refused."""

from fnmatch import fnmatchcase

import pytest

from grants.errors import PolicyRefused
from grants.model import Right
from grants.policy import sros2
from grants.policy.decision import Decider
from grants.policy.model import Effect, Subject
from grants.policy.sros2 import described, import_sros2
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
</profile>
<profile ns="/" node="not a node"><topics publish="ALLOW"><topic>a</topic></topics></profile>
<profile ns="/robot" node="talker"><actions call="ALLOW"><action>/go</action></actions></profile>
</profiles></enclave></enclaves></policy>"""


INCLUDE = '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="/etc/passwd"/>'


def _policy(content: str, node: str = "a") -> str:
    return f"""<policy version="0.2.0"><enclaves><enclave><profiles>
<profile ns="/" node="{node}">
{content}</profile></profiles></enclave></enclaves></policy>"""


def test_an_sros2_policy_is_imported() -> None:
    text, notes = import_sros2(TALKER)
    allow, deny, again = policy(text).rules
    assert [(item.right.label, item.pattern) for item in allow.clauses] == [
        ("publish", "/robot/chatter"),
        ("publish", "/abs"),
        ("publish", "{node}/own"),
        ("publish", "/robot/fib/status"),
        ("publish", "/robot/fib/feedback"),
        ("publish", "/robot/fib/result"),
        ("provide", "/add"),
        ("call", "/sub"),
        ("subscribe", "/robot/fib/goal"),
        ("subscribe", "/robot/fib/cancel"),
    ]
    assert (allow.subjects_text, str(deny.effect), deny.clauses[0].pattern) == (
        "/robot/talker",
        "deny",
        "/camera/**",
    )
    assert (again.id, again.clauses[0].right.label) == ("sros2-robot-talker-2", "publish")
    assert notes == [
        "read: /robot/talker: subscribe /camera/* as /camera/**, its * crosses / in SROS2",
        "/robot/talker: subscribe /robot/rt* is not a pattern of whole segments",
        "/robot/talker: /parameter_events exists in ROS 2 only",
        "profile /not a node: not a node name or pattern",
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
        (_policy('<topics publish="DENY"><topic>rt*</topic></topics>'), "publish /rt"),
        (_policy('<topics publish="DENY"><topic>a?</topic></topics>'), "publish /a.*whole segments"),
        (_policy('<topics publish="DENY"><topic>/a[bc]</topic></topics>'), "publish /a"),
        (_policy('<topics publish="deny"><topic>a</topic></topics>'), "'deny', not ALLOW or DENY"),
        (_policy('<topics publsh="DENY"><topic>a</topic></topics>'), "an attribute 'publsh'"),
        (_policy("<nodes/>"), "<nodes> is not an element"),
        (_policy("<action>a</action>"), "<action> is not expected in <profile>"),
        (_policy("<profile/>"), "<profile> is not expected in <profile>"),
        (_policy('<topics publish="DENY"><topic>a</topic></topics>', "no name"), "not a node name"),
        (_policy("", "default"), "'default' is every node of its enclave"),
        (_policy(INCLUDE), "line 3: the include of '/etc/passwd' is not followed"),
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
    profiles = f"<profiles>{one}{other}{one}{one}</profiles>"
    text, _ = import_sros2(f"<policy><enclaves><enclave>{profiles}</enclave></enclaves></policy>")
    ids = [rule.id for rule in policy(text).rules]
    assert ids == ["sros2-a", "sros2-a_2", "sros2-a-2", "sros2-a-3"]


@pytest.mark.parametrize(
    ("written", "kept", "denied"),
    [
        ("*", "/**", ["/a", "/a/b/c"]),
        ("*/cmd_vel", "/**/cmd_vel", ["/arm/cmd_vel", "/arm/left/cmd_vel"]),
        ("/fmu/*/out", "/fmu/**/out", ["/fmu/a/out", "/fmu/a/b/out"]),
        ("/fmu/out/*", "/fmu/out/**", ["/fmu/out/a", "/fmu/out/a/b"]),
        ("/plain", "/plain", ["/plain"]),
    ],
)
def test_what_is_denied_is_denied_as_wide(written: str, kept: str, denied: list[str]) -> None:
    content = (
        f'<topics publish="DENY"><topic>{written}</topic></topics>'
        f'<topics publish="ALLOW"><topic>{denied[-1]}</topic></topics>'
    )
    text, _ = import_sros2(_policy(content, "planner"))
    found = policy(text)
    (deny,) = [rule for rule in found.rules if str(rule.effect) == "deny"]
    assert [clause.pattern for clause in deny.clauses] == [kept]
    assert all(fnmatchcase(name, written if written[0] == "/" else f"/{written}") for name in denied)
    decider, subject = Decider(found), Subject("/planner", b"k" * 32, False)
    for name in denied:
        assert decider.decide(subject, Right.PUBLISH, name).effect is Effect.DENY, name


def test_a_denial_for_a_pattern_of_nodes_reaches_as_deep() -> None:
    denied = '<topics publish="DENY"><topic>/x</topic></topics>'
    (rule,) = policy(import_sros2(_policy(denied, "*"))[0]).rules
    assert rule.subjects_text == "/**"


def test_both_effects_of_one_element_and_an_empty_list() -> None:
    content = '<topics publish="ALLOW" subscribe="DENY"><topic>*/scan</topic></topics>'
    text, notes = import_sros2(_policy(content + '<services reply="DENY"/>'))
    effects = {
        str(rule.effect): [(each.right.label, each.pattern) for each in rule.clauses]
        for rule in policy(text).rules
    }
    assert effects == {"allow": [("publish", "/**/scan")], "deny": [("subscribe", "/**/scan")]}
    assert "read: /a: reply DENY as nothing, its list is empty" in notes


@pytest.mark.parametrize("version", ['version="0.1.0"', ""])
def test_another_version_is_noted(version: str) -> None:
    xml = _policy('<topics publish="ALLOW"><topic>a</topic></topics>')
    _, notes = import_sros2(xml.replace('version="0.2.0"', version))
    (note,) = notes
    assert note.startswith("read: the policy is of version")
    assert described(note) == note


def test_denials_of_names_of_ros_2_are_kept() -> None:
    denied = '<services request="DENY"><service>/robot/get_parameters</service></services>'
    (rule,) = policy(import_sros2(_policy(denied))[0]).rules
    assert [clause.pattern for clause in rule.clauses] == ["/robot/get_parameters"]


def test_all_that_cannot_be_kept_is_said() -> None:
    content = (
        '<topics publish="DENY"><topic>a?</topic><topic>b?</topic></topics>'
        '<topics publish="ALLOW"><topic>rt_*</topic></topics>'
    )
    with pytest.raises(PolicyRefused, match="2 parts of this policy cannot be kept") as caught:
        import_sros2(_policy(content))
    assert [str(each).partition(": ")[0] for each in caught.value.mistakes] == ["/a", "/a", "left out"]
