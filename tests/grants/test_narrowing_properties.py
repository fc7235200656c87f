"""What a narrowing can never do: give more than the links before it, or learn what they hide."""

import struct
from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grants.decision import Decision, Reach, authorize
from grants.errors import GrantError, GrantMissing, GrantRevoked
from grants.filters.layout import Layout
from grants.guard import Guard, MemoryScope, MemoryStore
from grants.model import Grant, Permission, Restriction, Right, filter_rules, merge
from grants.token import verify_chain
from tests.grants.authority import NOW
from tests.grants.chains import A, B, C, D, Made, chain_of, first, key_of
from tests.grants.messages import layout, text

MESSAGE_RIGHTS = [Right.PUBLISH, Right.SUBSCRIBE]
segments = st.sampled_from(["a", "b", "*", "**"])
patterns = st.lists(segments, min_size=1, max_size=2).map(lambda parts: "/" + "/".join(parts))
names = st.sampled_from(["/a", "/b", "/a/a", "/a/b", "/b/a/b"])
treatments = st.one_of(
    st.sampled_from([0.5, 1.0, 2.0, 0.7]).map(lambda step: {"round": {"step": step}}),
    st.sampled_from([(-1.0, 1.0), (0.4, 0.6)]).map(lambda ends: {"clamp": {"low": ends[0], "high": ends[1]}}),
    st.just({"clear": True}),
)
filters = st.dictionaries(st.sampled_from(["x", "y"]), treatments, max_size=2).map(filter_rules)
coordinates = st.sampled_from([-1.2, -0.6, 0.3, 0.45, 0.55, 0.74, 0.8, 0.95, 1.3, 1.9])
conditions = st.lists(
    st.sampled_from(["msg.x < 0.5", "msg.x >= 0.9", "msg.y > -1.0 || msg.x > 0.0", 'msg.frame != "secret"']),
    max_size=2,
)
typed = st.builds(
    lambda rules, texts: Restriction("t/T", (*texts,), rules) if rules or texts else None, filters, conditions
)
restrictions = typed | typed | typed | st.just(Restriction(conditions=("now.getHours() < 9",)))
permissions = st.builds(Permission, patterns, st.sampled_from([*MESSAGE_RIGHTS, Right(3)]), restrictions)
chains = st.lists(st.lists(permissions, min_size=1, max_size=3).map(tuple), min_size=2, max_size=4)
messages = st.tuples(coordinates, coordinates)


def accept(*_: object) -> None:
    """Nothing is revoked."""


def decide(grant: Grant, right: Right, name: str) -> Decision | None:
    try:
        return authorize([grant], right, name, holder=grant.holder, now=NOW, check=accept)
    except GrantMissing:
        return None


def prefixes(made: Made) -> list[Grant]:
    base = made.grant.links[0]
    many = range(1, len(made.narrowings) + 1)
    return [base, *(verify_chain(base, made.narrowings[:count]) for count in many)]


def sent(shape: Layout, decision: Decision, data: bytes) -> bytes | None:
    pieces = Guard(shape, decision)(data, NOW)
    return None if pieces is None else b"".join(pieces)


def alone(decision: Decision, link: Grant) -> Decision:
    """What the restrictions of one link are, without the others."""
    covering = (each for each in link.permissions if each.covers(decision.right, decision.name))
    found = merge(each.restriction for each in covering)
    return Decision(decision.right, decision.name, (), decision.expires, found)


@settings(max_examples=150, deadline=None)
@given(chains, st.sampled_from(MESSAGE_RIGHTS), names)
def test_what_a_chain_allows_every_prefix_allows(
    links: list[tuple[Permission, ...]], right: Right, name: str
) -> None:
    decisions = [decide(each, right, name) for each in prefixes(chain_of(links))]
    allowed = [each is not None for each in decisions]
    assert allowed == sorted(allowed, reverse=True)
    ends = [each.expires for each in decisions if each is not None]
    assert ends == sorted(ends, reverse=True)
    single = [
        any(each.covers(right, name) for each in link) for link in links
    ]  # every link alone, by the decision as it was before there were chains
    assert allowed == [all(single[: depth + 1]) for depth in range(len(links))]


@settings(max_examples=150, deadline=None)
@given(chains, st.sampled_from(MESSAGE_RIGHTS), messages, st.sampled_from(["map", "secret"]))
def test_the_bytes_that_leave_are_those_of_the_prefix_filtered_further(
    links: list[tuple[Permission, ...]], right: Right, xy: tuple[float, float], frame: str
) -> None:
    shape = layout("float64 x\nfloat64 y\nstring frame")
    everywhere = [tuple(Permission("/a", right, each.restriction) for each in link) for link in links]
    data = struct.pack("<dd", *xy) + text(frame)
    grants = prefixes(chain_of(everywhere))
    before: bytes | None = data
    for grant in grants:
        decision = decide(grant, right, "/a")
        assert decision is not None
        left = sent(shape, decision, data)
        last = alone(decision, grant.links[-1])
        assert left == (None if before is None else sent(shape, last, before))
        before = left


def test_a_condition_of_a_narrowing_reads_what_the_filters_left() -> None:
    """Else a holder could ask for every digit of a position it sees rounded."""
    shape = layout("float64 x")
    coarse = Restriction("t/T", (), filter_rules({"x": {"round": {"step": 2.0}}}))
    for border, passes in ((0.5, False), (0.9, False), (-0.1, True)):
        question = Restriction("t/T", (f"msg.x > {border:.1f}",))
        made = chain_of([subscribing(coarse), subscribing(question)])
        decision = decide(made.grant, Right.SUBSCRIBE, "/a")
        assert decision is not None
        expected = struct.pack("<d", 0.0) if passes else None
        assert sent(shape, decision, struct.pack("<d", 0.99)) == expected


def subscribing(restriction: Restriction | None = None) -> Permission:
    return Permission("/a", Right.SUBSCRIBE, restriction)


def test_rates_add_up_and_count_for_the_first_holder() -> None:
    store = MemoryStore(lambda: NOW)
    scope = MemoryScope(store, ("/node",))

    def guard(*made: Made) -> Guard:
        grants = [each.grant for each in made]
        decision = authorize(grants, Right.SUBSCRIBE, "/a", holder=grants[0].holder, now=NOW, check=accept)
        return Guard(None, decision, {}, scope)

    slow = first(subscribing(Restriction(rate=1.0)))
    to_b = slow.narrowed(A, subscribing())
    to_c = slow.narrowed(A, subscribing(Restriction(rate=5.0)), holder=key_of(C))
    guards = [guard(slow), guard(to_b), guard(to_c)]
    assert len(store) == 1
    assert [each.apply(b"x", NOW, "one") for each in guards] == [[b"x"]] * 3
    assert [each.apply(b"y", NOW, "two") for each in guards] == [None] * 3
    own = first(subscribing(Restriction(rate=9.0)), holder=B, subject="/b", serial=b"w" * 16)
    assert guard(to_b, own).memory is guards[0].memory  # no second account beside it
    assert guard(own).memory is not guards[0].memory


def test_an_open_connection_is_kept_only_if_every_link_says_so() -> None:
    keep = Restriction(keep_when_stale=True)
    for links, kept in (((keep, keep), True), ((keep, None), False), ((None, keep), False)):
        made = chain_of([subscribing(each) for each in links])
        decision = decide(made.grant, Right.SUBSCRIBE, "/a")
        assert decision is not None
        assert decision.keep_when_stale is kept
        decision.require_unrestricted()


def test_every_id_and_key_of_a_chain_can_be_revoked() -> None:
    made = chain_of([subscribing()] * 4)
    decision = decide(made.grant, Right.SUBSCRIBE, "/a")
    assert decision is not None
    entries = {*(link.id for link in made.grant.links), *map(key_of, (A, B, C, D))}
    assert set(decision.grant_ids) == set(made.grant.revocable) == entries
    for entry in entries:

        def check(asked: bytes, _: int, revoked: bytes = entry) -> None:
            if asked == revoked:
                raise GrantError("on the list")

        with pytest.raises(GrantRevoked):
            authorize([made.grant], Right.SUBSCRIBE, "/a", holder=key_of(D), now=NOW, check=check)


def test_near_misses_name_the_link() -> None:
    made = chain_of([Permission("/b", Right.SUBSCRIBE), subscribing()])
    with pytest.raises(GrantMissing) as refused:
        authorize([made.grant], Right.SUBSCRIBE, "/a", holder=made.grant.holder, now=NOW, check=accept)
    base = made.grant.links[0]
    assert f"grant {base.short_id} is for /b, not /a" in refused.value.near_misses


PARAMETERS = Right.PARAM_GET | Right.PARAM_SET
any_rights = st.integers(1, 255).map(Right)
plain = st.lists(st.builds(Permission, patterns, any_rights), min_size=1, max_size=3).map(tuple)


def below(space: str) -> Iterable[str]:
    return (f"{space}{rest}" for rest in ("/a", "/b", "/zz", "/a/a", "/zz/b"))


@settings(max_examples=100, deadline=None)
@given(st.lists(plain, min_size=2, max_size=3), st.sampled_from(list(Right)), names, any_rights)
def test_the_index_agrees_with_the_chain(
    links: list[tuple[Permission, ...]], right: Right, name: str, rights: Right
) -> None:
    grant = chain_of(links).grant
    reach = Reach.of([grant])
    assert reach.covers(right, name) == grant.covers(right, name)
    assert reach.covers_any(rights, name) == any(grant.covers(each, name) for each in Right if each in rights)
    if right in PARAMETERS:
        if reach.covers_below(right, name):
            assert all(grant.covers(right, each) for each in below(name))
        if not reach.touches(right, name):
            assert not any(grant.covers(right, each) for each in [name, *below(name)])
    else:
        assert not reach.covers_below(right, name)
    base = grant.links[0]
    both = Reach.of([grant, base])
    assert both.covers(right, name) == base.covers(right, name)
    assert reach.patterns(right) >= 1  # a chain is looked at for every name
