from collections import Counter
from collections.abc import Iterable, Iterator

from hypothesis import given
from hypothesis import strategies as st

from rossec.gateway.rules import BATCH, Observed, SourceCandidate, TopicRule, chosen, observing, rule
from rossec.participant.delivery_options import DeliveryOptions
from rossec.participant.registrations import Fact

RULES = (rule("ada", "/robot/**", DeliveryOptions()), rule("ben", "/**", DeliveryOptions(rate=1)))


def observed(facts: Iterable[Fact], rules: tuple[TopicRule, ...]) -> Observed:
    """All steps at once."""
    steps = observing(facts, rules)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: Observed = end.value
            return found


def published(label: str, name: str, kind: str = "std_msgs/String") -> Iterator[Fact]:
    topic = f"/remote/{label}{name}"
    yield "publisher", topic, f"/remote/{label}/node"
    yield "type", topic, kind


def test_a_topic_of_its_origin_that_a_rule_covers_is_a_candidate() -> None:
    facts = [
        *published("ada", "/robot/pose"),
        *published("ada", "/kitchen"),
        *published("ben", "/x"),
        *published("eve", "/robot/pose"),
        ("subscriber", "/remote/ada/robot/no", "/viewer"),
        ("publisher", "/robot/own", "/robot"),
        ("service", "/remote/ada/robot/s", "/remote/ada/n"),
    ]
    found = observed(facts, RULES).candidates
    assert found == {
        "/remote/ada/robot/pose": SourceCandidate(
            "/remote/ada/robot/pose", "/gateway/ada/robot/pose", RULES[0], "std_msgs/String"
        ),
        "/remote/ben/x": SourceCandidate("/remote/ben/x", "/gateway/ben/x", RULES[1], "std_msgs/String"),
    }


def test_only_publishers_of_the_origin_count_and_gateways_are_noted() -> None:
    facts = [
        ("publisher", "/remote/ada/robot/pose", "/gateway"),  # as it is shown to who may see it
        ("publisher", "/remote/ada/robot/pose", "/remote/ben/robot"),
        ("publisher", "/remote/ada/robot/pose", "/remote"),
        ("publisher", "/gateway/ada/robot/pose", "/gateway"),
        ("publisher", "/gateway/ada/robot/pose", "/gateway/attic"),
    ]
    found = observed(facts, RULES)
    assert found.candidates == {}
    assert found.servers["/gateway/ada/robot/pose"] == {"/gateway", "/gateway/attic"}


def test_a_topic_without_a_type_is_of_any() -> None:
    facts = [("publisher", "/remote/ben/x", "/remote/ben/n")]
    assert observed(facts, RULES).candidates["/remote/ben/x"].type == "*"


def test_a_topic_whose_served_name_would_be_too_long_is_left_out() -> None:
    name = "/remote/ben/" + "x" * 243
    assert len(name) == 255
    assert observed([("publisher", name, "/remote/ben/n")], RULES).candidates == {}


def some(label: str, count: int) -> list[SourceCandidate]:
    given = TopicRule(label, "/**")
    return [
        SourceCandidate(f"/remote/{label}/t{n:04}", f"/gateway/{label}/t{n:04}", given, "*")
        for n in range(count)
    ]


def test_an_origin_with_many_topics_takes_no_room_from_others() -> None:
    many, few = some("ada", 2000), some("ben", 30)
    serving = {each.alias for each in many[:1024]}  # before there was anything else
    found = chosen([*many, *few], serving)
    assert Counter(each.rule.label for each in found) == {"ben": 30, "ada": 994}
    assert {each.alias for each in found if each.rule.label == "ada"} < serving


def test_a_new_topic_replaces_none_that_is_served() -> None:
    all_of_it = some("ada", 10)
    serving = {each.alias for each in all_of_it[5:]}
    assert {each.alias for each in chosen(all_of_it, serving, 5)} == serving


@given(st.lists(st.integers(0, 40), max_size=6), st.integers(0, 60))
def test_the_room_is_used_and_shared(counts: list[int], most: int) -> None:
    found = chosen([each for n, count in enumerate(counts) for each in some(f"d{n}", count)], (), most)
    got = Counter(each.rule.label for each in found)
    assert len(found) == min(most, sum(counts))
    for number, count in enumerate(counts):
        least = min(count, most // len(counts))
        assert got[f"d{number}"] >= least


def test_an_origin_with_many_topics_takes_many_short_steps() -> None:
    facts = [fact for n in range(2 * BATCH) for fact in published("ben", f"/t{n}")]
    assert sum(1 for _ in observing(facts, RULES)) == 6, "four of facts, two of topics"
    assert len(observed(facts, RULES).candidates) == 2 * BATCH
