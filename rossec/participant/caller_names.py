"""A call to the master with another caller_id than the node's own name. Pure.

Tools, and programs before `init_node`, use names that no certificate covers; the master receives
the node's own. A relative name in such a call is resolved for the original caller, or it would
silently mean another key.
"""

from collections.abc import Iterator
from typing import Final

from ca.names import MAX_NAME
from rossec.ros import names

SEARCH: Final = "searchParam"
RELATIVE_NAME: Final = {
    "registerPublisher": 1, "registerSubscriber": 1, "registerService": 1,
    "unregisterPublisher": 1, "unregisterSubscriber": 1, "unregisterService": 1,
    "lookupNode": 1, "lookupService": 1, "getPublishedTopics": 1,
    "subscribeParam": 2, "unsubscribeParam": 2,
    "getParam": 1, "setParam": 1, "deleteParam": 1, "hasParam": 1,
}  # fmt: skip
"""Index of the parameter that is a name relative to the caller; the caller_id is 0."""

Params = tuple[object, ...]


def resolve_params(method: str, params: Params, caller: str) -> Params:
    """`params` with the name in them resolved for `caller`; an empty name stays as it is."""
    index = RELATIVE_NAME.get(method, len(params))
    name = params[index] if index < len(params) else None
    if not isinstance(name, str) or not name:
        return params
    return (*params[:index], names.resolve(name, caller), *params[index + 1 :])


def searched_key(method: str, params: Params) -> str | None:
    """The key that `searchParam` looks for from the caller's namespace; None for other calls."""
    match method, params:
        case "searchParam", (_, str() as key) if key and key[0] not in "/~":
            return key
        case _:
            return None


def search_places(caller: str, key: str) -> Iterator[tuple[str, str]]:
    """Where stock looks for `key`, innermost first: names that must exist, with their results."""
    return names.search_paths(caller[:MAX_NAME], key)


def search_result(answer: list[object], found: str) -> list[object] | None:
    """The result of the search, from the answer for one name; None: go on with the next."""
    match answer:
        case [1, *_]:
            return [1, f"Found [{found}]", found]
        case [-1, str(status), _] if not status.startswith("rossec: "):
            return None
        case _:
            return answer


def not_found(key: str) -> list[object]:
    """The answer when no name exists."""
    return [-1, f"Cannot find parameter [{key}] in an upwards search", ""]
