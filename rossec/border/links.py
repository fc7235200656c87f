"""What a thing has: its list of resources (RFC 6690), as topics and services. Pure.

`</t>;rt="ros.pub";if="sensor_msgs/Temperature";title="~temperature";ct=60` is a topic that the
thing publishes. A name that begins with `~` lies below the thing's own name; others are absolute.
Whether it may have that name is not decided here: its grants say so.
"""

import re
from dataclasses import dataclass
from typing import Final

from ca.errors import NameRefused
from ca.names import check_name
from rossec.border.quotas import MAX_OBSERVATIONS, MAX_RESOURCES
from rossec.errors import ThingLinksRefused

PUBLISHER, SUBSCRIBER, SERVICE = "ros.pub", "ros.sub", "ros.srv"
KINDS: Final = frozenset({PUBLISHER, SUBSCRIBER, SERVICE})
MAX_LIST: Final = 8192
MAX_PATH: Final = 64
ROS_BODY: Final = 65001  # content format: a ROS message as it is serialized
CBOR_BODY: Final = 60  # content format: a CBOR map of the fields
FORMATS: Final = frozenset({ROS_BODY, CBOR_BODY})
_TYPE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}/[A-Za-z][A-Za-z0-9_]{0,99}", re.ASCII)
_SEGMENT: Final = re.compile(r"[A-Za-z0-9_.-]{1,32}", re.ASCII)
_VALUE: Final = r'"[^"\\]*"|[^",;\s\\]*'
_PARAMETER: Final = re.compile(rf';\s*([^,;="\s]+)(?:=({_VALUE}))?')
_LINK: Final = re.compile(rf'\s*<([^<>"]*)>((?:;\s*[^,;="\s]+(?:=(?:{_VALUE}))?)*)\s*(?:,|\Z)')


@dataclass(frozen=True, slots=True)
class Resource:
    """One resource of a thing.

    Args:
        kind: `PUBLISHER`, `SUBSCRIBER` or `SERVICE`.
        path: its segments.
        type: the ROS type.
        name: the topic or the service, absolute.
        format: the content format of its bodies.
    """

    kind: str
    path: tuple[str, ...]
    type: str
    name: str
    format: int


def read_links(data: bytes, thing: str) -> list[Resource]:
    """The resources in a list that are for ROS; others are ignored.

    Args:
        thing: the name of the thing.

    Raises:
        ThingLinksRefused: malformed, too long, too many, or two with one name.
    """
    if len(data) > MAX_LIST:
        raise ThingLinksRefused(f"a list of resources of {len(data)} octets, at most {MAX_LIST}")
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError:
        raise ThingLinksRefused("a list of resources that is not ASCII") from None
    found = [each for each in (_resource(*link, thing) for link in _links(text)) if each]
    _check(found)
    return found


def _links(text: str) -> list[tuple[str, str]]:
    links: list[tuple[str, str]] = []
    end = 0
    while end < len(text):
        match = _LINK.match(text, end)
        if match is None or len(links) > MAX_RESOURCES:
            raise ThingLinksRefused(f"not a list of links at character {end}")
        links.append((match[1], match[2]))
        end = match.end()
    return links


def _resource(target: str, parameters: str, thing: str) -> Resource | None:
    values: dict[str, str] = {}
    for match in _PARAMETER.finditer(parameters):
        if match[1] in values:
            raise ThingLinksRefused(f"the link to {target!a} says {match[1]!a} twice")
        values[match[1]] = (match[2] or "").strip('"')
    kind = values.get("rt", "")
    if kind not in KINDS:
        return None
    type_name = values.get("if", "")
    if _TYPE.fullmatch(type_name) is None:
        raise ThingLinksRefused(f"{type_name!a} is not a ROS type", "package/Type")
    return Resource(
        kind, _path(target), type_name, _name(values.get("title", ""), thing),
        _format(values.get("ct", str(ROS_BODY))),
    )  # fmt: skip


def _path(target: str) -> tuple[str, ...]:
    segments = tuple(target.removeprefix("/").split("/"))
    good = all(_SEGMENT.fullmatch(each) and each not in {".", ".."} for each in segments)
    if not target.startswith("/") or len(target) > MAX_PATH or not good:
        raise ThingLinksRefused(f"{target[:MAX_PATH]!a} is not the path of a resource")
    return segments


def _name(title: str, thing: str) -> str:
    name = f"{thing}/{title[1:]}" if title.startswith("~") else title
    try:
        return check_name(name)
    except NameRefused as error:
        raise ThingLinksRefused(f"the name {title!a}: {error}", "~name, or /absolute") from None


def _format(value: str) -> int:
    if value not in {str(each) for each in FORMATS}:
        raise ThingLinksRefused(f"content format {value!a}", f"{ROS_BODY} or {CBOR_BODY}")
    return int(value)


def _check(found: list[Resource]) -> None:
    if sum(each.kind == PUBLISHER for each in found) > MAX_OBSERVATIONS:
        raise ThingLinksRefused(f"a thing publishes at most {MAX_OBSERVATIONS} topics")
    if len({(each.kind, each.name) for each in found}) != len(found):
        raise ThingLinksRefused("two resources of a thing have one name")
    if len({each.path for each in found}) != len(found):
        raise ThingLinksRefused("one resource of a thing is listed twice")
