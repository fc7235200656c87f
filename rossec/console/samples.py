"""What a receiver would see of some messages: the guard of its grants applied to them. Pure.

The messages are those of a preview, or made up (`made_up`); the guard is the one that stands before
a real connection (`grants.guard`). Only conditions are left out of a made-up drive, as nothing made
up could fulfil them. The keys of pseudonyms are the publishers' own, so here they are others.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass, replace
from typing import Any, Final, NamedTuple, Protocol

from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.layout import parse
from grants.guard import Guard, needed_keys
from grants.model import Restriction, Right
from rossec.errors import MessageError
from rossec.participant.message_types import field_names, field_value, message_type

_NEVER: Final = 1 << 52


class Recorded(NamedTuple):
    """The last messages of a topic, oldest first: time and serialized bytes of each."""

    topic: str
    type: str
    messages: tuple[tuple[float, bytes], ...]
    is_made_up: bool = False


class Sample(NamedTuple):
    """A message as a receiver gets it: its fields by name, messages in it as mappings."""

    at: float
    fields: Mapping[str, Any]


class SeenTopic(NamedTuple):
    """What one receiver saw, of `sent` messages; `is_made_up` if nobody really sent them."""

    receiver: str
    topic: str
    type: str
    sent: int
    samples: tuple[Sample, ...]
    is_made_up: bool = False


class Preview(Protocol):
    """Where the pages get real messages from."""

    def recorded(self, topic: str) -> Recorded | None:
        """The last minute of a topic; None if it is not received, or nothing came."""
        ...


def see(recorded: Recorded, receiver: str, restrictions: Iterable[Restriction]) -> SeenTopic:
    """What `receiver` gets of `recorded` under all of `restrictions`.

    Raises:
        GrantError: a restriction does not fit the type of the messages.
        MessageError: the type is unknown here.
    """
    applied = tuple(restrictions)
    if recorded.is_made_up:
        applied = tuple(_without_conditions(applied))
    kind = message_type(recorded.type)
    decision = Decision(Right.SUBSCRIBE, recorded.topic, (), _NEVER, applied)
    keys = {name: hashlib.sha256(name.encode()).digest() for name in needed_keys(applied)}
    guard = Guard(parse(kind.name, kind.definition), decision, keys)
    samples = []
    for at, message in recorded.messages:
        pieces = guard(message, int(at))
        if pieces is not None:
            samples.append(Sample(at, as_mapping(kind.deserialize(b"".join(pieces)))))
    return SeenTopic(
        receiver,
        recorded.topic,
        recorded.type,
        len(recorded.messages),
        tuple(samples),
        recorded.is_made_up,
    )


def try_see(
    recorded: Recorded, receiver: str, restrictions: Iterable[Restriction]
) -> SeenTopic | None:
    """As `see`; None where a real guard would refuse the connection."""
    try:
        return see(recorded, receiver, restrictions)
    except (GrantError, MessageError):
        return None


def _without_conditions(given: Iterable[Restriction]) -> Iterable[Restriction]:
    for each in given:
        if each.filters or each.rate is not None or each.slot is not None:
            yield replace(each, conditions=())


def as_mapping(message: Any) -> Mapping[str, Any]:
    """The fields of a message by name; arrays of numbers stay as they are."""
    return {name: _plain(field_value(message, name)) for name in field_names(message)}


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return as_mapping(value)
    return [_plain(each) for each in value] if isinstance(value, list) else value
