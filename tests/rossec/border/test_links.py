"""What a thing says that it has: links, read strictly and bounded."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.border.conversations import MAX_OBSERVATIONS, MAX_RESOURCES
from rossec.border.resources import (
    CBOR_BODY,
    MAX_LIST,
    PUBLISHER,
    ROS_BODY,
    SERVICE,
    SUBSCRIBER,
    Resource,
    read_links,
)
from rossec.errors import ThingError

LAMP = "/things/lamp"


def link(path: str = "/t", rt: str = "ros.pub", kind: str = "a/B", more: str = "") -> str:
    return f'<{path}>;rt="{rt}";if="{kind}";title="~{path[1:] or "x"}"{more}'


def test_topics_and_services_below_the_things_name() -> None:
    text = (
        '</.well-known/core>;ct="40",</t/1>;rt="ros.pub";if="sensor_msgs/Temperature";'
        'title="~temperature";obs,</l>;rt="ros.sub";if="std_msgs/Bool";title="~light";ct=60,'
        '</s>;rt="ros.srv";if="std_srvs/SetBool";title="/house/switch",'
        '<https://example.org/>;rel="impl-info"'
    )
    assert read_links(text.encode(), LAMP) == [
        Resource(PUBLISHER, ("t", "1"), "sensor_msgs/Temperature", f"{LAMP}/temperature", ROS_BODY),
        Resource(SUBSCRIBER, ("l",), "std_msgs/Bool", f"{LAMP}/light", CBOR_BODY),
        Resource(SERVICE, ("s",), "std_srvs/SetBool", "/house/switch", ROS_BODY),
    ]
    assert read_links(b"", LAMP) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<", "not a list of links"),
        ("</t>;rt=", ""),
        (link(kind="Bool"), "is not a ROS type"),
        (link(kind="../etc/passwd"), "is not a ROS type"),
        (link("t"), "not the path of a resource"),
        (link("/../t"), "not the path of a resource"),
        (link("/" + "a" * 64), "not the path of a resource"),
        (link("//t"), "not the path of a resource"),
        (link(more=";ct=50"), "content format"),
        (link(more=';ct="60 65001"'), "content format"),
        (link(more=';rt="ros.sub"'), "says 'rt' twice"),
        (f"{link()},{link()}", "one name"),
        ('</a>;rt="ros.pub";if="a/B";title="~x",</a>;rt="ros.sub";if="a/B";title="~y"', "twice"),
        ('</a>;rt="ros.pub";if="a/B";title="~x y"', "the name"),
        ('</a>;rt="ros.pub";if="a/B";title="x"', "the name"),
        ('</a>;rt="ros.pub";if="a/B"', "the name"),
        (",".join(link(f"/t{n}") for n in range(MAX_OBSERVATIONS + 1)), "publishes at most"),
        (",".join(f"</{n}>" for n in range(MAX_RESOURCES + 2)), "not a list of links"),
        ('</t>;title="' + "x" * MAX_LIST, "at most"),
        ("</ü>", "not ASCII"),
    ],
)
def test_what_is_not_in_form_is_refused(text: str, message: str) -> None:
    if not message:
        assert read_links(text.encode(), LAMP) == []
        return
    with pytest.raises(ThingError, match=message):
        read_links(text.encode(), LAMP)


@given(st.binary(max_size=200))
def test_any_bytes_are_links_or_refused(data: bytes) -> None:
    with contextlib.suppress(ThingError):
        assert isinstance(read_links(data, LAMP), list)
