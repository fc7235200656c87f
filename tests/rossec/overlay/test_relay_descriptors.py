"""Descriptors of relays."""

import json
from typing import Any

import pytest

from rossec.errors import RelayRefused
from rossec.overlay.documents import MAX_DESCRIPTOR, RelayDescriptor

KEY = "rossec/1/office/" + "a" * 32
DESCRIPTOR = RelayDescriptor("office.example", "/relay", KEY)


def test_a_descriptor_is_read_as_it_was_written() -> None:
    assert RelayDescriptor.read(DESCRIPTOR.write().encode()) == DESCRIPTOR
    assert KEY not in repr(DESCRIPTOR)


def test_a_part_of_a_descriptor_is_none() -> None:
    data = DESCRIPTOR.write().encode().rstrip()
    for length in range(len(data)):
        with pytest.raises(RelayRefused, match="not the descriptor of a relay"):
            RelayDescriptor.read(data[:length])
    with pytest.raises(RelayRefused):
        RelayDescriptor.read(data + b"x")
    with pytest.raises(RelayRefused):
        RelayDescriptor.read(data + b" " * MAX_DESCRIPTOR)


@pytest.mark.parametrize(
    "changes",
    [
        {"rossec-relay-descriptor": 2},
        {"more": 1},
        {"domain": "Office"},
        {"domain": 3},
        {"relay": "/robot"},
        {"relay": None},
        {"inbox": "rossec/**"},
        {"inbox": []},
    ],
)
def test_a_descriptor_in_another_form_is_refused(changes: dict[str, Any]) -> None:
    found = json.loads(DESCRIPTOR.write()) | changes
    with pytest.raises(RelayRefused, match="descriptor"):
        RelayDescriptor.read(json.dumps(found).encode())


def test_an_entry_that_occurs_twice_is_refused() -> None:
    twice = DESCRIPTOR.write().replace("{", '{"inbox": "rossec/1/other/' + "b" * 32 + '",', 1)
    with pytest.raises(RelayRefused, match="not the descriptor of a relay"):
        RelayDescriptor.read(twice.encode())
    with pytest.raises(RelayRefused):
        RelayDescriptor.read(DESCRIPTOR.write().replace('descriptor": 1', 'descriptor": true').encode())
