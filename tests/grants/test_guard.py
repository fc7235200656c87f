"""Guards: expiry, conditions, filters, and no message sent by mistake."""

import struct
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from grants.decision import Decision
from grants.errors import ConditionRefused, FilterRefused, GrantError, GrantExpired, MessageRefused
from grants.guard import Guard, Memory, needed_keys
from grants.model import Restriction, Right, filter_rules, merge
from tests.grants.messages import layout, text

LAYOUT = layout("float64 x\nfloat64 y\nstring frame\nP[] points", "MSG: t/P\nint32 a\nint32 b")
NOW = 1_800_000_000


def message(x: float = 1.3, frame: str = "map") -> bytes:
    return struct.pack("<dd", x, 2.7) + text(frame) + struct.pack("<Iii", 1, 5, 6)


def decision(*restrictions: Restriction) -> Decision:
    return Decision(Right.SUBSCRIBE, "/a", (), NOW + 10, merge(restrictions))


def filtered(**rules: dict[str, object]) -> Restriction:
    return Restriction("t/T", (), filter_rules(rules))


def when(*texts: str, type: str | None = "t/T") -> Restriction:  # noqa: A002
    return Restriction(type, texts)


def received(guard: Guard, data: bytes) -> bytes | None:
    pieces = guard(data, NOW)
    return None if pieces is None else b"".join(pieces)


def rounded(step: float) -> dict[str, object]:
    return {"round": {"step": step}}


def test_without_restrictions_the_message_is_untouched() -> None:
    data = message()
    for guard in (Guard(LAYOUT, decision()), Guard(None, decision())):
        assert guard(data, NOW) == [data]


def test_conditions_then_filters() -> None:
    coarse = Restriction("t/T", ('msg.frame == "map"',), filter_rules({"x": rounded(0.5)}))
    guard = Guard(LAYOUT, decision(coarse, when("msg.x < 1.4")))
    assert received(guard, message()) == message(1.5)  # the condition read 1.3, the receiver gets 1.5
    assert received(guard, message(1.45)) is None
    assert received(guard, message(frame="odom")) is None


def test_expiry_is_checked_by_check_alone() -> None:
    guard = Guard(LAYOUT, decision())
    guard.check(NOW + 9)
    for check in (guard.check, lambda now: guard(message(), now)):
        with pytest.raises(GrantExpired, match="the grant expired at"):
            check(NOW + 10)
    assert guard.apply(message(), NOW + 10) == [message()]  # expiry is `check`'s


def test_a_restriction_for_another_type_is_refused() -> None:
    for shape in (replace(LAYOUT, type_name="t/Other"), None):
        for restriction in (filtered(x=rounded(1)), when("true")):
            with pytest.raises(GrantError, match="for messages of type t/T, these are"):
                Guard(shape, decision(restriction))


def test_a_restriction_without_a_type_applies_to_all_types() -> None:
    day = when("now.getHours() >= 9", type=None)
    for shape in (LAYOUT, None):
        assert Guard(shape, decision(day))(message(), NOW) is None
    with pytest.raises(ConditionRefused, match="needs a message type"):
        Guard(LAYOUT, decision(when("msg.x > 0.0", type=None)))


def test_a_restriction_that_does_not_fit_the_layout_is_refused() -> None:
    with pytest.raises(ConditionRefused):
        Guard(LAYOUT, decision(when("msg.z > 0.0")))
    with pytest.raises(FilterRefused):
        Guard(LAYOUT, decision(filtered(z={"clear": True})))


@pytest.mark.parametrize(
    ("one", "two"),
    [
        (filtered(x=rounded(0.5)), filtered(x=rounded(2.0))),
        (filtered(x=rounded(0.5)), filtered(y=rounded(2.0))),
        (filtered(x=rounded(0.5)), filtered(x=rounded(0.5), frame={"clear": True})),
        (
            Restriction("t/T", (), filter_rules({"points[*].a": {"clear": True}})),
            filtered(points={"clear": True}),
        ),
    ],
)
def test_all_filters_apply_in_one_order(one: Restriction, two: Restriction) -> None:
    both, swapped = Guard(LAYOUT, decision(one, two)), Guard(LAYOUT, decision(two, one))
    assert both.key == swapped.key
    result = received(both, message(0.8))
    assert result == received(swapped, message(0.8))
    assert result is not None
    for alone in (one, two):  # each alone has nothing left to remove
        assert received(Guard(LAYOUT, decision(alone)), result) == result


def test_filters_for_different_fields_share_one_pass() -> None:
    guard = Guard(LAYOUT, decision(filtered(x=rounded(0.5)), filtered(y=rounded(2.0)), when("true")))
    assert [len(layer.filters) for layer in guard._layers] == [1]


def test_the_key_covers_layout_and_restrictions_but_not_expiry() -> None:
    guard = Guard(LAYOUT, decision(filtered(x=rounded(0.5))))
    same = Guard(LAYOUT, replace(decision(filtered(x=rounded(0.5))), expires=NOW + 99))
    assert {guard.key} == {same.key}
    for other in (
        Guard(LAYOUT, decision()),
        Guard(LAYOUT, decision(filtered(x=rounded(0.25)))),
        Guard(replace(LAYOUT, digest=b"0"), decision(filtered(x=rounded(0.5)))),
        Guard(None, decision()),
    ):
        assert other.key != guard.key


def test_a_message_of_another_layout_is_refused() -> None:
    guard = Guard(LAYOUT, decision(filtered(x=rounded(0.5))))
    for data in (b"", message()[:-1], message() + b"\0"):
        with pytest.raises(MessageRefused, match="not a t/T"):
            guard(data, NOW)


def test_an_unexpected_error_withholds_the_message(monkeypatch: pytest.MonkeyPatch) -> None:
    guard = Guard(LAYOUT, decision(when("true")))

    def broken(*_: object) -> bool:
        raise MemoryError

    monkeypatch.setattr(guard, "_conditions", (broken,))
    with pytest.raises(MessageRefused, match="applying restrictions failed: MemoryError"):
        guard(message(), NOW)


@pytest.mark.parametrize("answer", [1, "yes", None, 0])
def test_only_the_value_true_admits_a_message(answer: object) -> None:
    guard = Guard(LAYOUT, decision(when("true")))
    guard._conditions = (lambda *_: cast("bool", answer),)
    assert guard(message(), NOW) is None


def test_a_rate_admits_messages_as_tokens_are_refilled() -> None:
    guard = Guard(LAYOUT, decision(Restriction(rate=0.2), Restriction("t/T", ("msg.x < 5.0",))))
    data = message()

    def admitted(*times: int) -> list[bool]:
        return [guard.apply(data, NOW + at) is not None for at in times]

    assert guard.apply(message(9.0), NOW) is None  # withheld by its condition, and not counted
    assert admitted(0, 0, 4, 5, 6, 10, 100, 100) == [True, False, False, True, False, True, True, False]
    assert admitted(50, 51, 54) == [False, False, False]  # a clock set back adds no tokens
    assert admitted(55, 56) == [True, False]


def test_the_lowest_rate_applies() -> None:
    guard = Guard(None, decision(Restriction(rate=3), Restriction(rate=2.5)))
    assert [guard.apply(b"", NOW) is not None for _ in range(4)] == [True, True, False, False]
    assert [guard.apply(b"", NOW + 1) is not None for _ in range(4)] == [True, True, False, False]


def test_hysteresis_belongs_to_one_receiver() -> None:
    held: dict[str, object] = {"round": {"step": 1.0, "hysteresis": 0.25}}
    rules = decision(filtered(x=held, y=held))
    one, other = Guard(LAYOUT, rules), Guard(LAYOUT, rules)
    assert received(one, message(1.4)) == message(1.0).replace(_double(2.7), _double(3.0))
    assert received(one, message(1.6)) == received(one, message(1.4))
    assert received(other, message(1.6)) != received(one, message(1.6))
    with pytest.raises(FilterRefused, match=r"hysteresis cannot be used on t/P\[\]"):
        Guard(LAYOUT, decision(filtered(points={"round": {"step": 2, "hysteresis": 1}})))


def _double(value: float) -> bytes:
    return struct.pack("<d", value)


def test_guards_with_separate_memories_have_different_keys() -> None:
    held = filtered(x={"round": {"step": 1.0, "hysteresis": 0.25}})
    for restriction in (held, Restriction(rate=1)):
        one, other = (Guard(LAYOUT, decision(restriction)) for _ in range(2))
        assert one.key == one.key != other.key


def test_guards_with_one_memory_share_rate_and_hysteresis() -> None:
    """Whatever the number of connections and the time they are opened."""
    held: dict[str, object] = {"round": {"step": 1.0, "hysteresis": 0.25}}
    memory = Memory()
    limited = Restriction("t/T", (), filter_rules({"x": held, "y": held}), rate=0.5)
    one, other = (Guard(LAYOUT, decision(limited), None, lambda _: memory) for _ in range(2))
    assert one.key == other.key
    message_id = object()
    assert one.apply(message(1.4), NOW, message_id) == other.apply(message(1.4), NOW, message_id)
    assert other.apply(message(1.6), NOW) is None
    assert not other.ready(NOW)
    assert other.ready(NOW + 2)
    treated = other.apply(message(1.6), NOW + 2)
    assert treated is not None
    assert b"".join(treated)[:8] == _double(1.0)
    assert Guard(LAYOUT, decision()).ready(NOW)


def test_a_field_of_another_type_has_separate_hysteresis() -> None:
    memory = Memory()
    rules = Restriction("t/T", (), filter_rules({"x": {"round": {"step": 2, "hysteresis": 1}}}))
    seen = []
    for kind, code in (("float64", "d"), ("int32", "i")):
        guard = Guard(layout(f"{kind} x"), decision(rules), None, lambda _: memory)
        pieces = guard(struct.pack(f"<{code}", 3), NOW)
        assert pieces is not None
        seen.append(struct.unpack(f"<{code}", b"".join(pieces))[0])
    assert seen == [4.0, 4]


def test_hash_filters_need_their_keys() -> None:
    hashed = filtered(frame={"hash": {"key": "ward"}})
    assert needed_keys([hashed, filtered(x={"clear": True})]) == {"ward"}
    assert needed_keys([]) == set()
    with pytest.raises(FilterRefused, match="no key 'ward'"):
        Guard(LAYOUT, decision(hashed))
    treated = received(Guard(LAYOUT, decision(hashed), {"ward": bytes(32)}), message())
    assert treated is not None
    assert b"map" not in treated


def of_holder(holder: int, *restrictions: Restriction) -> Decision:
    grant: Any = SimpleNamespace(holder=bytes([holder]) * 32, chain=())
    grant.links = (grant,)
    return replace(decision(*restrictions), grants=(grant,))


def test_pseudonyms_for_each_receiver_are_not_shared() -> None:
    """What was filtered for one receiver is sent to others whose guards have the same key."""
    keys = {"map": bytes(32)}
    own = filtered(frame={"hash": {"key": "map", "per": "receiver"}})
    common = filtered(frame={"hash": {"key": "map"}})
    one, two = (Guard(LAYOUT, of_holder(holder, own), keys) for holder in (1, 2))
    again = Guard(LAYOUT, of_holder(1, own), keys)
    assert received(one, message()) == received(again, message()) != received(two, message())
    assert one.key == again.key != two.key
    assert len({Guard(LAYOUT, of_holder(n, common), keys).key for n in (1, 2)}) == 1


def test_a_slot_tells_no_moment() -> None:
    restriction = replace(filtered(x={"clear": True}), slot=60)
    guard = Guard(LAYOUT, replace(decision(restriction), expires=NOW + 10**6))
    times = [NOW + n / 10 for n in range(123, 3000)]
    assert [now for now in times if guard(message(), now)] == [NOW + 60 * n for n in range(1, 5)]
    assert not guard.ready(NOW + 299)
    assert guard.ready(NOW + 300.5)


def test_the_longest_slot_and_the_lowest_rate_apply_together() -> None:
    restrictions = (Restriction(slot=10), Restriction(slot=20, rate=1 / 40))
    guard = Guard(None, replace(decision(*restrictions), expires=NOW + 10**6))
    times = range(NOW, NOW + 100)
    assert [now - NOW for now in times if guard(b"", now)] == [20, 60]


def test_slots_of_many_lengths_tell_no_more_than_the_longest() -> None:
    """Whoever may narrow its right makes as many as it likes, and may present one after another."""
    memory, end = Memory(), NOW + 10**6
    guards = [
        Guard(None, replace(decision(Restriction(slot=slot)), expires=end), None, lambda _: memory)
        for slot in range(600, 630)
    ]
    times = range(NOW, NOW + 40_000)
    passed = {now for now in times for guard in guards if guard(b"", now)}
    assert 50 < len(passed) < 40_000 / 600 + 1
    later = range(NOW + 42_000, NOW + 45_000)  # the longer ones are not presented any more
    assert len([now for now in later if guards[0](b"", now)]) >= 3
    assert len([now for now in range(NOW - 10**5, NOW - 10**5 + 3000) if guards[0](b"", now)]) >= 3


def test_a_message_in_a_slot_goes_to_all_connections_of_a_key() -> None:
    memory = Memory()
    guards = [Guard(None, decision(Restriction(slot=10)), None, lambda _: memory) for _ in "ab"]
    assert [guard.apply(b"x", NOW - 1, "first") for guard in guards] == [None, None]
    assert [guard.apply(b"x", NOW + 0.25, "second") for guard in guards] == [[b"x"], [b"x"]]
    assert [guard.apply(b"y", NOW + 0.25, "another") for guard in guards] == [None, None]


def test_conditions_see_whole_seconds() -> None:
    early = Restriction(None, ("now.getSeconds() == 0",))
    guard = Guard(None, decision(early))
    assert guard(b"", NOW + 0.75) == [b""]
    assert guard(b"", NOW + 1.25) is None
