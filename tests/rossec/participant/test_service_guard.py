"""Which restriction of a right applies to which message of a call; no connection."""

import secrets
from pathlib import Path

import pytest

from grants.decision import Decision
from grants.errors import FilterRefused, GrantError, GrantExpired, MessageRefused
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ConfigurationError, ServiceRefused
from rossec.participant.service_types import ServiceGuard, service_type
from tests.support.memory_scopes import HOLDER, fresh

KIND = service_type("std_srvs/SetBool")
ON, OFF = b"\1", b"\0"
ANSWER = b"\1\3\0\0\0yes"
NOW = 1000


def no_key(name: str) -> bytes:
    raise ConfigurationError(f"no key {name}")


def guard(*restrictions: Restriction) -> ServiceGuard:
    decision = Decision(Right.CALL, "/lamp/on", (HOLDER,), NOW + 10, restrictions)
    return ServiceGuard(KIND, decision, no_key, fresh())


def test_a_right_without_restrictions_allows_every_message() -> None:
    both = guard()
    assert b"".join(both.request(ON, NOW)) == ON
    assert b"".join(both.response(ANSWER, NOW)) == ANSWER


def test_a_condition_for_the_request_type_applies_to_requests() -> None:
    both = guard(Restriction("std_srvs/SetBoolRequest", ("!msg.data",)))
    assert b"".join(both.request(OFF, NOW)) == OFF
    with pytest.raises(ServiceRefused, match="/lamp/on does not allow this request, or not now"):
        both.request(ON, NOW)
    assert b"".join(both.response(ANSWER, NOW)) == ANSWER


def test_a_filter_for_the_response_type_applies_to_responses() -> None:
    rules = filter_rules({"message": {"clear": True}})
    both = guard(Restriction("std_srvs/SetBoolResponse", ("msg.success",), rules))
    assert b"".join(both.request(ON, NOW)) == ON
    assert b"".join(both.response(ANSWER, NOW)) == b"\1\0\0\0\0"
    with pytest.raises(ServiceRefused, match="does not allow this response"):
        both.response(b"\0\0\0\0\0", NOW)


def test_a_filter_rewrites_a_request() -> None:
    rules = filter_rules({"data": {"clear": True}})
    assert b"".join(guard(Restriction("std_srvs/SetBoolRequest", (), rules)).request(ON, 1)) == OFF


def test_a_rate_counts_once_for_each_call() -> None:
    both = guard(Restriction(rate=0.001))
    both.request(ON, NOW)
    for _ in range(3):
        both.response(ANSWER, NOW)
    with pytest.raises(ServiceRefused):
        both.request(ON, NOW)


@pytest.mark.parametrize("kind", ["std_srvs/SetBool", "std_srvs/TriggerResponse", "a/Request"])
def test_a_restriction_for_another_type_is_refused(kind: str) -> None:
    with pytest.raises(GrantError, match=f"messages of type {kind}"):
        guard(Restriction(kind, ("now > timestamp('2020-01-01T00:00:00Z')",)))


def test_a_missing_pseudonym_key_is_refused(tmp_path: Path) -> None:
    rules = filter_rules({"message": {"hash": {"key": "door", "length": 8}}})
    hashed = Restriction("std_srvs/SetBoolResponse", (), rules)
    with pytest.raises(ConfigurationError, match="no key door"):
        guard(hashed)
    decision = Decision(Right.CALL, "/lamp/on", (HOLDER,), NOW + 10, (hashed,))
    both = ServiceGuard(KIND, decision, lambda _: secrets.token_bytes(32), fresh())
    assert len(b"".join(both.response(ANSWER, NOW))) == 5 + 8


def test_an_expired_right_and_malformed_bytes_are_refused() -> None:
    both = guard(Restriction("std_srvs/SetBoolRequest", ("!msg.data",)))
    for apply in (both.request, both.response):
        with pytest.raises(GrantExpired):
            apply(OFF, NOW + 10)
    rules = filter_rules({"message": {"clear": True}})
    with pytest.raises(MessageRefused):
        guard(Restriction("std_srvs/SetBoolResponse", (), rules)).response(b"", NOW)


def test_a_filter_for_an_unknown_field_is_refused() -> None:
    rules = filter_rules({"massage": {"clear": True}})
    with pytest.raises(FilterRefused):
        guard(Restriction("std_srvs/SetBoolResponse", (), rules))
