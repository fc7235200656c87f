"""What cannot be in a grant is found before it is signed, as the verifier would say it."""

import pytest

from grants.errors import PolicyRefused
from grants.model import FilterRule, Permission, Restriction, Right
from grants.policy.restrictions import MAX_ENTRIES, divide, why_unsignable
from tests.grants.policy.policies import HEADER, mistakes, policy


def entry(*conditions: str) -> Permission:
    return Permission("/p", Right.SUBSCRIBE, Restriction("std_msgs/String", conditions))


def test_what_verifiers_accept_can_be_signed() -> None:
    assert why_unsignable((Permission("/p", Right.CALL),)) == ""
    assert why_unsignable((entry('msg.data == "a"'), entry('msg.data != "b"'))) == ""


def test_what_verifiers_refuse_cannot_be_signed() -> None:
    assert "too large" in why_unsignable(tuple(entry(f'msg.data == "{"x" * 900}{n}"') for n in range(20)))
    assert why_unsignable((entry("msg.data =="),))
    odd = FilterRule("data", "redact", (("text", "\ud800"),))
    bad = Permission("/p", Right.SUBSCRIBE, Restriction("std_msgs/String", (), (odd,)))
    assert why_unsignable((bad,)) == "a text in it is not Unicode"


@pytest.mark.parametrize(
    "restriction",
    [
        "filter: {data: {redact: " + "x" * 17_000 + "}}",
        "when: [" + ", ".join(f"'msg.data != \"{n}{'x' * 900}\"'" for n in range(20)) + "]",
    ],
)
def test_a_rule_that_cannot_be_signed_is_a_mistake_of_the_policy(restriction: str) -> None:
    head = HEADER + "types: {/p: std_msgs/String, ~/p: std_msgs/String}\n"
    for name in ("/p", "~/p"):
        rule = f"  - {{id: a, who: /x, allow: {{subscribe: [{name}]}}, {restriction}}}\n"
        (found,) = mistakes(f"{head}rules:\n{rule}")
        assert "too large for one grant" in found.message
        assert (found.line, found.column) == (5, 42)


def test_half_a_pair_of_surrogates_is_a_mistake_with_its_place() -> None:
    with pytest.raises(PolicyRefused, match=r"test\.yaml:2:8: a text is not Unicode"):
        policy('rossec: 1\nrobot: "\\ud800"\nrules: []\n')


def test_rights_are_divided_among_grants_in_order() -> None:
    """Where what a right needs stays together."""
    sizes = [1] * MAX_ENTRIES + [2, MAX_ENTRIES + 3, 1]
    made = [
        tuple(Permission(f"/r{at}/p{n}", Right.CALL) for n in range(size)) for at, size in enumerate(sizes)
    ]
    parts = list(divide(range(len(sizes)), made.__getitem__))
    assert [each for part in parts for each in part] == list(range(len(sizes)))
    assert len(parts) > 3
    counts = [sum(sizes[each] for each in part) for part in parts]
    assert all(count <= MAX_ENTRIES or len(part) == 1 for count, part in zip(counts, parts, strict=True))
    assert list(divide([], made.__getitem__)) == []
    long = [tuple(entry(f'msg.data == "{"x" * 900}{n}"') for n in range(4)) for _ in range(4)]
    assert len(list(divide(range(4), long.__getitem__))) > 1
