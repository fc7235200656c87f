"""A call to the master that is made under another name than the node's own. Pure.

Tools, and programs before they have their name, give names that no certificate covers; the master
hears the node's own. What is relative in such a call must go on meaning what it meant to who asked,
or it would silently be about another key.
"""

from collections.abc import Iterator
from typing import Final

from ca.names import MAX_NAME
from rossec.ros import names

SEARCH: Final = "searchParam"
RELATIVE: Final = {
    "registerPublisher": 1, "registerSubscriber": 1, "registerService": 1,
    "unregisterPublisher": 1, "unregisterSubscriber": 1, "unregisterService": 1,
    "lookupNode": 1, "lookupService": 1, "getPublishedTopics": 1,
    "subscribeParam": 2, "unsubscribeParam": 2,
    "getParam": 1, "setParam": 1, "deleteParam": 1, "hasParam": 1,
}  # fmt: skip
"""Which parameter of a call, the caller_id counted as 0, is a name that is relative to it."""

Params = tuple[object, ...]


def as_meant(method: str, params: Params, asker: str) -> Params:
    """`params` with the name in them as `asker` means it; an empty one has a meaning of its own."""
    index = RELATIVE.get(method, len(params))
    name = params[index] if index < len(params) else None
    if not isinstance(name, str) or not name:
        return params
    return (*params[:index], names.resolve(name, asker), *params[index + 1 :])


def searched(method: str, params: Params) -> str | None:
    """The key that is searched from the asker's namespace, if that is what a call does."""
    match method, params:
        case "searchParam", (_, str() as key) if key and key[0] not in "/~":
            return key
        case _:
            return None


def places(asker: str, key: str) -> Iterator[tuple[str, str]]:
    """Where stock looks for `key`, innermost first: what must exist, and what is found then."""
    return names.upwards(asker[:MAX_NAME], key)


def settled(answer: list[object], found: str) -> list[object] | None:
    """What the answer to one place means for the search; None: look further out."""
    match answer:
        case [1, *_]:
            return [1, f"Found [{found}]", found]
        case [-1, str(status), _] if not status.startswith("rossec: "):
            return None
        case _:
            return answer


def nowhere(key: str) -> list[object]:
    """The answer when there was no such place."""
    return [-1, f"Cannot find parameter [{key}] in an upwards search", ""]
