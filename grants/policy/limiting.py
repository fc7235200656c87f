"""The `limit` of a rule: a rate, a slot, the body that its topics show, and padding."""

from typing import Final, NamedTuple

from grants.limits import MAX_PAD, MAX_SLOT, MIN_PAD, MIN_SLOT, is_body
from grants.policy import readers
from grants.policy.mistakes import Mistakes
from grants.policy.source import Part

_KEYS: Final = ("rate", "slot", "body", "pad")


class _Whole(NamedTuple):
    key: str
    wrong: str
    units: str
    least: int
    most: int


_SLOT: Final = _Whole("slot", "a slot of {:g} s", "seconds", MIN_SLOT, MAX_SLOT)
_PAD: Final = _Whole("pad", "padding to {:g} bytes", "bytes", MIN_PAD, MAX_PAD)


class Limit(NamedTuple):
    """What limits the messages of a rule's subscriptions; None where nothing does."""

    rate: float | None = None
    slot: int | None = None
    body: str | None = None
    pad: int | None = None


def read_limit(
    part: Part | None, topics: list[str], name: str, mistakes: Mistakes, *, seen: bool = True
) -> Limit:
    """The limit of the rule `name` on `topics`; mistakes are added.

    `seen`: it subscribes to them; what it only publishes has no slot and no body.
    """
    mapping = readers.mapping(part, f"limit of rule {name}", mistakes)
    if mapping is None:
        return Limit()
    readers.check_keys(mapping, f"limit of rule {name}", _KEYS, (), mistakes)
    given = mapping.entries.keys() & set(_KEYS)
    if not topics:
        mistakes.add(mapping, f"rule {name}: nothing to limit", "add a subscribe or publish right")
    elif not given:
        mistakes.add(mapping, f"rule {name}: an empty limit", "for example {rate: 1}")
    if not seen and given & {"slot", "body"}:
        hint = "a rule that only publishes may have a rate"
        message = f"rule {name}: a slot or a body is of what is subscribed to"
        mistakes.add(mapping, message, hint)
    return Limit(
        readers.number(mapping.get("rate"), "rate", mistakes) if "rate" in given else None,
        _whole(mapping.get("slot"), _SLOT, mistakes) if "slot" in given else None,
        _body(mapping.get("body"), mistakes) if "body" in given else None,
        _whole(mapping.get("pad"), _PAD, mistakes) if "pad" in given else None,
    )


def _whole(part: Part | None, kind: _Whole, mistakes: Mistakes) -> int | None:
    found = readers.number(part, kind.key, mistakes)
    if found is None:
        return None
    if float(found).is_integer() and kind.least <= found <= kind.most:
        return int(found)
    if part is not None:
        hint = f"whole {kind.units}, from {kind.least} to {kind.most}"
        mistakes.add(part, kind.wrong.format(found), hint)
    return None


def _body(part: Part | None, mistakes: Mistakes) -> str | None:
    found = readers.text(part, "body", mistakes)
    if found is None or is_body(found):
        return found
    if part is not None:
        mistakes.add(
            part, f"not a name of a body: {found[:40]!r}",
            "a letter, then at most 63 letters, digits, - and _",
        )  # fmt: skip
    return None
