"""Service types by their ROS 1 name: request and response types, and the md5sum. No ROS needed.

`rosbags` knows messages only; the definitions of Noetic's standard services are written here, and
others are added from the text of their `.srv` files. The parts of `std_srvs/SetBool` are the
message types `std_srvs/SetBoolRequest` and `std_srvs/SetBoolResponse`, as genpy names them.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

from grants.filters import layout
from grants.filters.layout import Layout
from rossec.errors import MessageError
from rossec.participant.message_types import MessageType, message_type, register_types
from rossec.participant.type_packages import what_to_install

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
        "nav_msgs/OccupancyGrid map\ngeometry_msgs/PoseWithCovarianceStamped initial_pose\n"
        "---\nbool success"
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
    """One service type: `name` is `package/Type`."""

    name: str
    request: MessageType
    response: MessageType

    @cached_property
    def request_layout(self) -> Layout:
        """Where the fields of a request are in its bytes."""
        return layout.parse(self.request.name, self.request.definition)

    @cached_property
    def response_layout(self) -> Layout:
        """Where the fields of a response are in its bytes."""
        return layout.parse(self.response.name, self.response.definition)

    @cached_property
    def md5sum(self) -> str:
        """The md5sum of the service, as in TCPROS headers."""
        return layout.service_md5(self.request_layout, self.response_layout)


@cache
def service_type(name: str) -> ServiceType:
    """Look up a service type by its ROS name, for example `std_srvs/SetBool`.

    Raises:
        MessageError: an unknown type.
    """
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
    """A message type, or one part of a service type (`std_srvs/SetBoolRequest`).

    Raises:
        MessageError: an unknown type.
    """
    whole = name.removesuffix("Request").removesuffix("Response")
    if whole in _STANDARD:
        service_type(whole)
    return message_type(name)


def register_service_type(name: str, definition: str) -> ServiceType:
    """Add the type `name` from the text of its `.srv` file; nested types must be known already.

    Raises:
        MessageError: the text is not a service definition, or the name is taken by another type.
    """
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
    register_types(
        {
            f"{name}Request": "\n".join(lines[: dividers[0]]),
            f"{name}Response": "\n".join(lines[dividers[0] + 1 :]),
        }
    )
