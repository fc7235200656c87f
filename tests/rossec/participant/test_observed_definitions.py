"""Definitions as programs in the field send them, each with its right answer."""

from pathlib import Path
from typing import Final

import pytest

from grants.decision import Decision
from grants.errors import DefinitionRefused, GrantError
from grants.filters import layout
from grants.model import FilterRule, Restriction, Right
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.definitions import (
    Definition,
    definition_fields,
    forwarded_definition,
    guard_for,
    receiver_definition,
    sender_definition,
)
from rossec.participant.message_types import message_type

OBSERVED: Final = Path(__file__).parents[2] / "vectors" / "observed"
STAMPED: Final = message_type("geometry_msgs/PoseStamped")
TWIST: Final = message_type("geometry_msgs/Twist")
EMPTY_MD5: Final = "d41d8cd98f00b204e9800998ecf8427e"


def observed(name: str) -> str:
    return (OBSERVED / f"{name}.txt").read_bytes().decode()


def restricted(kind: str, *filters: FilterRule) -> Decision:
    return Decision(Right.SUBSCRIBE, "/x", (), 2_000_000_000, (Restriction(kind, (), filters, rate=1.0),))


def unrestricted() -> Decision:
    return Decision(Right.SUBSCRIBE, "/x", (), 2_000_000_000, ())


def host(name: str) -> Definition | None:
    known = {each.name: each for each in (STAMPED, TWIST)}.get(name)
    return None if known is None else Definition(known.name, known.md5sum, known.definition)


def nothing(_: str) -> None:
    return None


ROSNODEJS: Final = Definition(STAMPED.name, STAMPED.md5sum, observed("rosnodejs_indented_no_dependencies"))


def test_without_its_nested_types_the_definition_of_the_host_counts() -> None:
    """rosnodejs indents, and sends no nested types."""
    wanted = restricted(STAMPED.name)
    found = sender_definition(ROSNODEJS, wanted, host)
    assert found.definition == STAMPED.definition
    assert receiver_definition(ROSNODEJS, STAMPED, wanted, host) == found
    assert forwarded_definition(ROSNODEJS, wanted, host) == found
    assert definition_fields(found, wanted)["message_definition"] == found.octets


@pytest.mark.parametrize("known", [nothing, lambda name: Definition(name, "f" * 32, "int8 a\n")])
def test_where_the_host_does_not_know_it_what_to_install_is_said(known: object) -> None:
    for choose in (sender_definition, forwarded_definition):
        with pytest.raises(ConnectionHeaderRefused) as caught:
            choose(ROSNODEJS, restricted(STAMPED.name), known)  # type: ignore[arg-type]
        assert caught.value.hint.endswith("apt install ros-geometry-msgs")


@pytest.mark.parametrize("text", [observed("empty_for_a_type_with_fields"), "\n", "# only words"])
def test_nothing_is_never_taken_for_a_message_without_fields(text: str) -> None:
    """Neither with the md5sum of its type nor with that of nothing."""
    wanted = restricted(TWIST.name, FilterRule("linear.x", "clear", ()))
    said = Definition(TWIST.name, TWIST.md5sum, text)
    if text.strip():
        with pytest.raises(ConnectionHeaderRefused):
            sender_definition(said, wanted, host)
    else:
        assert sender_definition(said, wanted, host).definition == TWIST.definition
        with pytest.raises(ConnectionHeaderRefused, match="does not say all of it"):
            sender_definition(said, wanted, nothing)
    forged = Definition(TWIST.name, EMPTY_MD5, text)
    with pytest.raises((GrantError, ConnectionHeaderRefused)):
        guard_for(sender_definition(forged, wanted, host), wanted, bytes, lambda _: None)  # type: ignore[arg-type]


def test_lines_that_end_as_in_windows_are_named_as_the_cause() -> None:
    said = Definition("own_msgs/Blob", "0" * 32, observed("crlf_everywhere"))
    with pytest.raises(DefinitionRefused, match="end with CR LF") as caught:
        sender_definition(said, restricted("own_msgs/Blob"), nothing)
    assert "dos2unix" in caught.value.hint
    assert sender_definition(said, unrestricted(), nothing) is said
    assert layout.parse("std_msgs/String", "string data\r\n").md5 == ("992ce8a1687cec8c8bd883ec73ca41d1")


def test_a_backslash_and_an_n_are_named_as_the_cause() -> None:
    """Webots wrote them where lines should end."""
    said = Definition("webots_ros/Float64Stamped", "0" * 32, observed("webots_literal_backslash_n"))
    with pytest.raises(DefinitionRefused, match="a backslash and an n") as caught:
        sender_definition(said, restricted(said.name), host)
    assert len(str(caught.value).splitlines()) == 1
    assert sender_definition(said, unrestricted(), nothing) is said
    assert receiver_definition(said, said, unrestricted(), nothing) is said
