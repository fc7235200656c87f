"""Service types by their ROS 1 name, and what a decision means for the two messages of a call. No ROS needed.

`rosbags` knows messages only; the definitions of Noetic's standard services are written here, and others are
added from the text of their `.srv` files. The parts of `std_srvs/SetBool` are the message types
`std_srvs/SetBoolRequest` and `std_srvs/SetBoolResponse`, as genpy names them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Final

from ca.names import shown
from grants.decision import Decision
from grants.filters import layout
from grants.filters.layout import Buffer, Layout
from grants.guard import Guard, MemoryScope, needed_keys
from rossec.errors import MessageError, ServiceRefused
from rossec.participant.definitions import what_to_install
from rossec.participant.message_types import MessageType, message_type, register_types

Pieces = Sequence[Buffer]

_DIVIDER: Final = "---"
# As in Debian's std_srvs, roscpp, nav_msgs, sensor_msgs, diagnostic_msgs and tf2_msgs, comments
# left out; a test compares the md5sums with those packages.
_STANDARD: Final = {
    "std_srvs/Empty": "---",
    "std_srvs/SetBool": "bool data\n---\nbool success\nstring message",
    "std_srvs/Trigger": "---\nbool success\nstring message",
    "roscpp/Empty": "---",
    "roscpp/GetLoggers": "---\nLogger[] loggers",
    "roscpp/SetLoggerLevel": "string logger\nstring level\n---",
    "nav_msgs/GetMap": "---\nnav_msgs/OccupancyGrid map",
    "nav_msgs/GetPlan": (
        "geometry_msgs/PoseStamped start\ngeometry_msgs/PoseStamped goal\nfloat32 tolerance\n"
        "---\nnav_msgs/Path plan"
    ),
    "nav_msgs/LoadMap": (
        "string map_url\n---\n"
        "uint8 RESULT_SUCCESS=0\nuint8 RESULT_MAP_DOES_NOT_EXIST=1\n"
        "uint8 RESULT_INVALID_MAP_DATA=2\nuint8 RESULT_INVALID_MAP_METADATA=3\n"
        "uint8 RESULT_UNDEFINED_FAILURE=255\nnav_msgs/OccupancyGrid map\nuint8 result"
    ),
    "nav_msgs/SetMap": (
        "nav_msgs/OccupancyGrid map\ngeometry_msgs/PoseWithCovarianceStamped initial_pose\n---\nbool success"
    ),
    "sensor_msgs/SetCameraInfo": (
        "sensor_msgs/CameraInfo camera_info\n---\nbool success\nstring status_message"
    ),
    "diagnostic_msgs/AddDiagnostics": ("string load_namespace\n---\nbool success\nstring message"),
    "diagnostic_msgs/SelfTest": "---\nstring id\nbyte passed\nDiagnosticStatus[] status",
    "tf2_msgs/FrameGraph": "---\nstring frame_yaml",
}


@dataclass(frozen=True)
class ServiceType:
    name: str
    request: MessageType
    response: MessageType

    @cached_property
    def request_layout(self) -> Layout:
        return layout.parse(self.request.name, self.request.definition)

    @cached_property
    def response_layout(self) -> Layout:
        return layout.parse(self.response.name, self.response.definition)

    @cached_property
    def md5sum(self) -> str:
        return layout.service_md5(self.request_layout, self.response_layout)


@cache
def service_type(name: str) -> ServiceType:
    """Look up a service type by its ROS name, for example `std_srvs/SetBool`."""
    if name in _STANDARD:
        _register(name, _STANDARD[name])
    try:
        return ServiceType(name, message_type(f"{name}Request"), message_type(f"{name}Response"))
    except MessageError:
        raise MessageError(
            f"unknown service type {name!r}",
            f"names look like std_srvs/SetBool; its .srv file: {what_to_install(name)}; then add it"
            " with register_service_type(), or --definition FILE",
        ) from None


def part_type(name: str) -> MessageType:
    """A message type, or one part of a service type (`std_srvs/SetBoolRequest`)."""
    whole = name.removesuffix("Request").removesuffix("Response")
    if whole in _STANDARD:
        service_type(whole)
    return message_type(name)


def register_service_type(name: str, definition: str) -> ServiceType:
    """Add the type `name` from the text of its `.srv` file; nested types must be known already."""
    if name in _STANDARD:
        service_type(name)  # so that another definition of it is a conflict
    _register(name, definition)
    return service_type(name)


def _register(name: str, definition: str) -> None:
    lines = definition.split("\n")
    dividers = [number for number, line in enumerate(lines) if line.startswith(_DIVIDER)]
    if len(dividers) != 1:
        raise MessageError(
            f"cannot register {name}: {len(dividers)} lines '---'",
            "a .srv file is the request, one line ---, and the response",
        )
    request, response = lines[: dividers[0]], lines[dividers[0] + 1 :]
    register_types({f"{name}Request": "\n".join(request), f"{name}Response": "\n".join(response)})


class ServiceGuard:
    """Filters the requests and responses of one connection: a guard for each.

    A restriction for the response type applies to responses; every other one applies to requests, so that a
    rate or a time counts once per call. One for any other type refuses the connection. Both ends use this:
    the server with the client's right to call, the client with the server's right to provide. `memory` finds
    what earlier connections of the same key have used up.
    """

    def __init__(
        self, kind: ServiceType, decision: Decision, filter_key: Callable[[str], bytes], memory: MemoryScope
    ) -> None:
        keys = {name: filter_key(name) for name in needed_keys(decision.restrictions)}
        restrictions = decision.restrictions
        on_response = tuple(item for item in restrictions if item.type == kind.response.name)
        on_request = tuple(item for item in restrictions if item.type != kind.response.name)
        self._name = shown(decision.name)
        request, response = (replace(decision, restrictions=some) for some in (on_request, on_response))
        self._request = Guard(kind.request_layout, request, keys, memory)
        self._response = Guard(kind.response_layout, response, keys, memory.child("response"))

    def request(self, data: Buffer, now: float) -> Pieces:
        return self._filter(self._request, "request", data, now)

    def response(self, data: Buffer, now: float) -> Pieces:
        return self._filter(self._response, "response", data, now)

    def _filter(self, guard: Guard, what: str, data: Buffer, now: float) -> Pieces:
        pieces = guard(data, now)
        if pieces is None:
            raise ServiceRefused(
                f"the grant for {self._name} does not allow this {what}, or not now",
                "a condition or the rate in the grant forbids it: see `rossec grant show`",
            )
        return pieces
