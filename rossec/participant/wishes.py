"""What a subscriber wishes of how it is sent messages: a rate, the newest only, deflated. Pure.

Fields of the connection header (docs/spec/transport.md section 2.1): the subscriber's say what it
wishes, the answer's what this publisher carries out; one that knows none ignores them all. A wish
never gives more than the grant: guards come first, and what they let through is thinned out, kept
back or made smaller; what is filtered or withheld is never deflated. What programs write into these
fields is not passed on: an agent that forwards bytes could not read what came of it.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from grants.decision import Decision
from rossec.errors import ConfigurationError, ConnectionHeaderRefused
from rossec.participant.header_fields import Fields

RATE: Final = "rossec_rate"
NEWEST: Final = "rossec_newest"
DEFLATE: Final = "rossec_deflate"
_FIELDS: Final = frozenset((RATE, NEWEST, DEFLATE))
_LOWEST, _HIGHEST = 0.001, 10_000
_RATE: Final = re.compile(rb"[0-9]{1,5}(\.[0-9]{1,3})?")
_YES: Final = b"1"


@dataclass(frozen=True)
class Wishes:
    """The wishes for one connection; false if there are none.

    Args:
        rate: at most so many messages a second, 0.001 to 10000, to three decimals; None: all.
        newest: of the messages that wait for a slow line only the newest is sent.
        deflate: messages are sent compressed.

    Raises:
        ConfigurationError: the rate is none of these.
    """

    rate: float | None = None
    newest: bool = False
    deflate: bool = False

    def __post_init__(self) -> None:
        if self.rate is None:
            return
        if not _LOWEST <= self.rate <= _HIGHEST:  # false for what is no number, too
            raise ConfigurationError(
                f"a rate of {self.rate} messages a second",
                f"it must be from {_LOWEST} to {_HIGHEST}",
            )
        object.__setattr__(self, "rate", round(float(self.rate), 3))

    def __bool__(self) -> bool:
        return self != NO_WISHES

    @property
    def fields(self) -> Fields:
        """The fields of a connection header that say them."""
        found = {} if self.rate is None else {RATE: f"{self.rate:.3f}".encode()}
        found |= {NEWEST: _YES} if self.newest else {}
        return found | ({DEFLATE: _YES} if self.deflate else {})


NO_WISHES: Final = Wishes()


def requested_wishes(fields: Mapping[str, bytes]) -> Wishes:
    """What the header of a subscriber wishes.

    Raises:
        ConnectionHeaderRefused: a field is malformed, or a rate is out of range.
    """
    if _FIELDS.isdisjoint(fields):
        return NO_WISHES
    return Wishes(_rate(fields), _is_set(fields, NEWEST), _is_set(fields, DEFLATE))


def carried_out(wishes: Wishes, decision: Decision) -> Wishes:
    """What a publisher carries out for a right: nothing filtered, withheld or padded is deflated.

    Encryption leaves the length of a message visible. That of a filtered one has few values, and
    deflated it depends on them: whoever sees the network, without any grant, would read the cell.
    """
    restrictions = decision.restrictions
    if any(each.filters or each.conditions or each.slot or each.pad for each in restrictions):
        return replace(wishes, deflate=False)
    return wishes


def check_carried_out(wishes: Wishes, decision: Decision) -> None:
    """Return if the wishes that are carried out on a connection may be under another decision.

    Raises:
        ConnectionHeaderRefused: they may not: the peer and this node agree anew.
    """
    if carried_out(wishes, decision) != wishes:
        raise ConnectionHeaderRefused("messages that are filtered now were to be sent deflated")


def taken_wishes(answer: Mapping[str, bytes], asked: Wishes) -> Wishes:
    """What the publisher with this answer carries out: those that were asked, or some of them.

    Raises:
        ConnectionHeaderRefused: a field is malformed, or says what was not asked.
    """
    taken = requested_wishes(answer)
    if taken.rate not in (None, asked.rate) or taken.newest > asked.newest:
        raise ConnectionHeaderRefused("the publisher answers another wish than it was asked")
    if taken.deflate > asked.deflate:
        raise ConnectionHeaderRefused("the publisher deflates messages, and was not asked to")
    return taken


def without_wishes(fields: Mapping[str, bytes]) -> Fields:
    """The header without its fields about wishes."""
    return {key: value for key, value in fields.items() if key not in _FIELDS}


def _rate(fields: Mapping[str, bytes]) -> float | None:
    value = fields.get(RATE)
    if value is None:
        return None
    if _RATE.fullmatch(value) and _LOWEST <= float(value) <= _HIGHEST:
        return float(value)
    raise ConnectionHeaderRefused(
        f"the connection header's {RATE!r} is no rate", f"it is a decimal, {_LOWEST} to {_HIGHEST}"
    )


def _is_set(fields: Mapping[str, bytes], key: str) -> bool:
    value = fields.get(key)
    if value not in (None, _YES):
        raise ConnectionHeaderRefused(f"the connection header's {key!r} is not 1")
    return value is not None
