"""Layouts of the standard types, without ROS."""

from functools import cache

from grants.filters.layout import Layout, parse
from rossec.participant.message_types import message_type, type_names

PACKAGES = ("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs")
STANDARD = sorted(name for name in type_names() if name.split("/")[0] in PACKAGES)


@cache
def layout_of(name: str) -> Layout:
    return parse(name, message_type(name).definition)
