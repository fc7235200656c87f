"""Own names in grants of the policy: each node's, and those of a tail in a grant of its own."""

from itertools import product

from hypothesis import given, settings
from hypothesis import strategies as st

from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.difference import NodeDifference, RecordedGrant, difference
from grants.policy.model import Subject
from grants.policy.wanted import WantedState
from tests.grants.policy.policies import node, rules
from tests.grants.policy.test_difference import MOMENT, applied, compare, signed

NODES = ("/r", "/r_1", "/r_1x", "/rx", "/a/r", "/r/a")
NAMES = [*NODES, *(f"{node}{end}" for node, end in product(NODES, ("/p", "/p/q", "_2/p", "_/p")))]
allowed = st.sampled_from(["{node}", "{node}/p", "{node}/**", "/r/p", "/*/p", "/**", "/r_1/*"])
denied = st.sampled_from(["/r/p", "/r_1/p", "{node}/p", "/r_2/**", "/*/q", "/r/p/q"])
effects = st.sampled_from([Right.PUBLISH, Right.PARAM_SET])


@settings(max_examples=60)
@given(
    st.lists(st.tuples(allowed, effects), min_size=1, max_size=3),
    st.lists(st.tuples(denied, effects), max_size=2),
    st.sampled_from(NODES),
    st.booleans(),
)
def test_no_signed_entry_gives_a_name_that_the_policy_does_not(
    allow: list[tuple[str, Right]], deny: list[tuple[str, Right]], node: str, tail: bool
) -> None:
    lines = [
        f"{{id: {effect}{at}, who: '*', {effect}: {{{right.label}: ['{pattern}']}}}}"
        for effect, clauses in (("allow", allow), ("deny", deny))
        for at, (pattern, right) in enumerate(clauses)
    ]
    decider = Decider(rules(*lines))
    subject = Subject(node, bytes(32), tail)
    for each in WantedState(decider).of(subject).rights:
        for entry, name in product(each.permissions, NAMES):
            if entry.covers(each.right, name):
                assert decider.decide(subject, each.right, name), (each.pattern, name)


def test_tail_patterns_are_signed_in_a_grant_of_their_own_and_kept_until_the_tail_goes() -> None:
    """A master or node from before refuses a grant with one, and must not lose the others."""
    policy = rules('{id: a, who: "*", allow: {provide: [~/get_loggers], publish: [/map]}}')
    rviz = Subject("/rviz", bytes(32), tail=True)

    def compared(subject: Subject, *recorded: RecordedGrant) -> NodeDifference:
        return difference(WantedState(Decider(policy)), subject, recorded, MOMENT)

    first = compared(rviz)
    assert [[each.pattern for each in group] for group in first.sign] == [["/rviz~/get_loggers"], ["/map"]]
    held = signed(first, subject=rviz)
    assert compared(rviz, *held).sign == ()
    assert compared(rviz, *held).revoke == ()
    plain = compared(node("/rviz"), *held)
    assert [grant.permissions[0].pattern for grant in plain.revoke] == ["/rviz~/get_loggers"]
    assert [[each.pattern for each in group] for group in plain.sign] == [["/rviz/get_loggers"]]


def test_own_names_are_signed_in_one_grant_with_the_others() -> None:
    policy = rules('{id: a, who: "*", allow: {provide: [~/get_loggers], publish: [/map]}}')
    (group,) = compare(policy).sign
    assert [each.pattern for each in group] == ["/x/get_loggers", "/map"]
    held = applied(policy)
    assert applied(policy, *held) == held
