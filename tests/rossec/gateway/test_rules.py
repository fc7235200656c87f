import pytest

from rossec.errors import ConfigurationError
from rossec.gateway.rules import TopicRule, covering, rule
from rossec.participant.delivery_options import DeliveryOptions

SLOW = DeliveryOptions(rate=2)


def test_the_first_rule_that_covers_a_topic_counts() -> None:
    rules = [rule("ada", "/robot/pose", SLOW), rule("ada", "/robot/**", DeliveryOptions())]
    assert covering(rules, "/remote/ada/robot/pose") == TopicRule("ada", "/robot/pose", SLOW)
    assert covering(rules, "/remote/ada/robot/tf") == TopicRule("ada", "/robot/**")
    assert covering(rules, "/remote/ada/kitchen") is None
    assert covering(rules, "/remote/eve/robot/pose") is None
    assert covering(rules, "/robot/pose") is None


def test_what_gateways_serve_there_is_not_handed_to_and_fro() -> None:
    """Two domains whose gateways serve all of each other would name a topic without end."""
    theirs, all_of_it = "/remote/ada/gateway/ben/pose", rule("ada", "/**", SLOW)
    assert covering([all_of_it], theirs) is None
    assert covering([all_of_it], "/remote/ada/gatewayx/pose") == all_of_it
    asked = rule("ada", "/gateway/ben/*", DeliveryOptions())
    assert covering([all_of_it, asked], theirs) == asked


@pytest.mark.parametrize(
    ("label", "pattern", "says", "hint"),
    [
        ("Ada!", "/pose", "is not a label", "rossec domain list"),
        ("ada", "ada:/pose", "is a name here, not at its origin", "--from ada /pose"),
        ("ada", "/remote/ada/pose", "is a name here, not at its origin", "--from ada /pose"),
        ("ada", "/remote/eve/pose", "they travel one hop", "--from THAT-DOMAIN"),
        ("ada", "pose", "not a name pattern", "whole segment"),
        ("ada", "/po*", "not a name pattern", "whole segment"),
        ("ada", "eve:/pose", "not a name pattern", "no label"),
    ],
)
def test_a_wrong_rule_says_what_to_write(label: str, pattern: str, says: str, hint: str) -> None:
    with pytest.raises(ConfigurationError, match=says) as caught:
        rule(label, pattern, DeliveryOptions())
    assert hint in caught.value.hint
