"""The limit of a rule: a rate, a slot, a body; each alone or together, read strictly."""

import pytest

from grants.policy.restrictions import Limit, read_limit
from grants.policy.source import Mistakes, read_source


def read(text: str, topics: list[str] | None = None) -> tuple[Limit, list[tuple[str, str]]]:
    mistakes = Mistakes("a.yaml")
    part = read_source(text, mistakes)
    found = read_limit(part, ["/pose"] if topics is None else topics, "a")
    return found, [(each.message, each.hint) for each in mistakes.found]


def test_no_limit_limits_nothing() -> None:
    assert read_limit(None, [], "a") == Limit()


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("{rate: 0.5}", Limit(0.5)),
        ("{slot: 30}", Limit(slot=30)),
        ("{slot: 86400, body: robot-1}", Limit(slot=86400, body="robot-1")),
        ("{rate: 1, slot: 10, body: a}", Limit(1, 10, "a")),
        ("{pad: 256}", Limit(pad=256)),
        ("{rate: 1, pad: 65536}", Limit(1, pad=65536)),
    ],
)
def test_it_is_read(text: str, limit: Limit) -> None:
    assert read(text) == (limit, [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "rule a: an empty limit"),
        ("{slot: 9}", "a slot of 9 s"),
        ("{slot: 30.5}", "a slot of 30.5 s"),
        ("{slot: 86401}", "a slot of 86401 s"),
        ("{pad: 31}", "padding to 31 bytes"),
        ("{pad: 64.5}", "padding to 64.5 bytes"),
        ("{pad: 65537}", "padding to 65537 bytes"),
        ("{body: 'no name'}", "not a name of a body: 'no name'"),
        ("{body: 9a}", "not a name of a body: '9a'"),
        ("{bodies: a}", "unknown key 'bodies' in limit of rule a"),
    ],
)
def test_a_mistake_is_said(text: str, message: str) -> None:
    found, mistakes = read(text)
    assert message in [said for said, _ in mistakes]
    assert (found.slot, found.body) == (None, None)
    assert all(hint for _, hint in mistakes[:1])


def test_there_must_be_something_to_limit() -> None:
    assert read("{slot: 30}", [])[1] == [("rule a: nothing to limit", "add a subscribe or publish right")]
