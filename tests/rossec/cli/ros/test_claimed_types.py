"""The type by which messages of a publisher are shown."""

import dataclasses

import pytest

from rossec.cli.ros.topic import readable
from rossec.errors import MessageError
from rossec.participant.definitions import Definition
from rossec.participant.message_types import message_type

TEXT = (
    "Header header\nclaimed_msgs/Part part\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
    "uint32 seq\ntime stamp\nstring frame_id\n" + "=" * 80 + "\nMSG: claimed_msgs/Part\n"
    "float32 share\n"
)


def test_a_known_type_is_read_by_what_is_known_here() -> None:
    known = message_type("std_msgs/String")
    assert readable(Definition(known.name, known.md5sum, "")) == known
    with pytest.raises(MessageError, match="another one than here"):
        readable(Definition(known.name, "0" * 32, "string other\n"))


def test_an_unknown_type_is_read_by_the_definition_of_its_publisher() -> None:
    with pytest.raises(MessageError, match="another one than here"):
        readable(Definition("claimed_msgs/First", "0" * 32, "uint8 one\n"))
    kind = message_type("claimed_msgs/First")
    claimed = Definition("claimed_msgs/Whole", "0" * 32, TEXT)
    with pytest.raises(MessageError):
        readable(claimed)
    whole = message_type("claimed_msgs/Whole")
    message = readable(dataclasses.replace(claimed, md5sum=whole.md5sum)).create()
    assert message.part.share == 0.0
    assert readable(kind) == kind


def test_what_is_no_definition() -> None:
    with pytest.raises(MessageError):
        readable(Definition("claimed_msgs/None", "0" * 32, "this is not one"))
