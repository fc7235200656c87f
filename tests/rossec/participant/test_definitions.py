"""Which side's definition a guard is built from."""

from dataclasses import replace
from typing import Final

import pytest

from grants.decision import Decision
from grants.errors import DefinitionRefused, GrantError
from grants.model import Restriction, Right
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.definitions import (
    Definition,
    definition_fields,
    forwarded_definition,
    from_header,
    receiver_definition,
    reported_definition,
    sender_definition,
    size_of,
)
from rossec.participant.message_types import message_type

PATH: Final = message_type("nav_msgs/Path")
WORD: Final = Definition("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n")
ANY: Final = Definition("*", "*", "")
FORGED: Final = Definition(
    PATH.name, PATH.md5sum, PATH.definition.replace("PoseStamped[] poses", "PoseStamped[0] poses")
)


def restricted(*types: str | None) -> Decision:
    limits = tuple(Restriction(kind, ("true",)) for kind in types)
    return Decision(Right.PUBLISH, "/path", (), 1, limits)


def undefined(kind: Definition) -> Definition:
    return Definition(kind.name, kind.md5sum, "")


def nothing(_: str) -> None:
    return None


def unasked(name: str) -> Definition:
    raise AssertionError(name)


def host(name: str) -> Definition | None:
    return {PATH.name: Definition(PATH.name, PATH.md5sum, PATH.definition), WORD.name: WORD}.get(name)


def test_a_forged_definition_has_the_same_md5sum() -> None:
    assert FORGED.layout.md5 == PATH.layout.md5
    assert FORGED.layout.digest != PATH.layout.digest


def test_the_type_is_read_from_a_header() -> None:
    fields = {"type": b"std_msgs/String", "md5sum": WORD.md5sum.encode()}
    assert from_header(fields) == undefined(WORD)
    defined = from_header({**fields, "message_definition": b"string data\n"})
    assert defined == WORD
    odd = from_header({**fields, "message_definition": b"# caf\xe9\nstring data"})
    with pytest.raises(DefinitionRefused, match="lone surrogates"):
        _ = odd.layout
    with pytest.raises(ConnectionHeaderRefused, match="'md5sum'"):
        from_header({"type": b"*"})


def test_the_definition_of_a_receiver_is_its_own() -> None:
    """Even if the publisher claims another one with the same md5sum."""
    assert receiver_definition(PATH, FORGED, restricted(PATH.name), nothing) is PATH
    assert receiver_definition(PATH, FORGED, restricted(PATH.name), host) is PATH
    assert receiver_definition(WORD, FORGED, restricted(WORD.name), unasked) is WORD


def test_a_receiver_without_a_definition_uses_the_installed_one() -> None:
    for own in (undefined(PATH), ANY, replace(ANY, name=PATH.name)):
        found = receiver_definition(own, FORGED, restricted(PATH.name), host)
        assert found.definition == PATH.definition


def test_a_definition_of_the_publisher_is_used_if_the_md5sum_of_the_receiver_proves_it() -> None:
    wanted = restricted(WORD.name)
    assert receiver_definition(undefined(WORD), WORD, wanted, unasked) == WORD
    assert receiver_definition(undefined(WORD), undefined(WORD), wanted, host) == WORD
    forged = replace(WORD, definition="string[] data")
    assert receiver_definition(undefined(WORD), forged, wanted, host) == WORD
    for own, said in ((undefined(WORD), forged), (ANY, WORD), (replace(ANY, name=WORD.name), WORD)):
        with pytest.raises(ConnectionHeaderRefused, match="how this subscriber reads a std_msgs/String"):
            receiver_definition(own, said, wanted, nothing)


def test_an_unknown_definition_is_refused() -> None:
    other = replace(PATH, md5sum="0" * 32)
    for own, known in ((undefined(PATH), nothing), (ANY, nothing), (undefined(other), host)):
        with pytest.raises(ConnectionHeaderRefused, match="is not known here") as caught:
            receiver_definition(own, FORGED, restricted(PATH.name), known)
        assert "ROS_PACKAGE_PATH" in str(caught.value.hint)


def test_a_right_for_another_type_is_refused_before_a_definition_is_looked_up() -> None:
    for own in (ANY, WORD, undefined(WORD)):
        with pytest.raises(GrantError, match="these are std_msgs/String"):
            receiver_definition(own, WORD, restricted(PATH.name), unasked)
    with pytest.raises(GrantError):
        sender_definition(WORD, restricted(WORD.name, PATH.name), unasked)


def test_the_definition_of_a_sender_must_match_the_installed_one() -> None:
    wanted = restricted(PATH.name)
    assert sender_definition(PATH, wanted, host) is PATH
    assert sender_definition(FORGED, wanted, nothing) is FORGED
    assert sender_definition(WORD, restricted(WORD.name), unasked) is WORD
    newer = Definition(PATH.name, "f" * 32, PATH.definition)
    assert sender_definition(FORGED, wanted, lambda _: newer) is FORGED
    with pytest.raises(ConnectionHeaderRefused, match="not the one this host knows"):
        sender_definition(FORGED, wanted, host)
    with pytest.raises(ConnectionHeaderRefused, match="does not have the md5sum"):
        sender_definition(newer, wanted, host)


def test_the_definition_of_what_is_forwarded_must_be_proven_or_installed() -> None:
    assert forwarded_definition(WORD, restricted(WORD.name), unasked) is WORD, "proven"
    assert forwarded_definition(PATH, restricted(PATH.name), host) is PATH
    assert forwarded_definition(FORGED, restricted(), unasked) is FORGED, "nobody reads it"
    for sent, known in ((PATH, nothing), (FORGED, nothing), (FORGED, host)):
        with pytest.raises(ConnectionHeaderRefused):
            forwarded_definition(sent, restricted(sent.name), known)
    with pytest.raises(ConnectionHeaderRefused, match="is not known on this host") as caught:
        forwarded_definition(PATH, restricted(PATH.name), nothing)
    assert "apt install ros-nav-msgs" in caught.value.hint


def test_no_definition_is_looked_up_without_a_restriction_for_a_type() -> None:
    for decision in (restricted(), restricted(None)):
        assert receiver_definition(ANY, ANY, decision, unasked) is ANY
        assert sender_definition(ANY, decision, unasked) is ANY
        assert definition_fields(ANY, decision) == {}


def test_the_size_of_messages_is_known_for_fixed_types_only() -> None:
    twist = message_type("geometry_msgs/Twist")
    assert size_of(twist) == 48
    assert [size_of(kind) for kind in (WORD, ANY, undefined(twist), PATH)] == [None] * 4


def test_the_reported_definition_of_a_receiver_is_its_own_or_proven() -> None:
    """A publisher cannot choose the size limit by its claim."""
    number = message_type("std_msgs/Int32")
    assert reported_definition(number, FORGED) is number
    assert size_of(reported_definition(undefined(number), number)) == 4
    assert reported_definition(undefined(number), WORD) == undefined(number)
    assert reported_definition(ANY, number) is ANY
    assert reported_definition(undefined(PATH), FORGED) == undefined(PATH)


def test_the_header_fields_of_a_definition() -> None:
    assert definition_fields(WORD, restricted(WORD.name)) == {
        "type": b"std_msgs/String",
        "md5sum": WORD.md5sum.encode(),
        "message_definition": b"string data\n",
    }
