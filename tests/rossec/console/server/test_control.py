"""Words between the supervisor and its web process."""

import pytest

from ca.encoding import encode
from rossec.console.server.control import CERTIFICATE, READY, ControlMessage, read, write
from rossec.errors import KeyMessageRefused


@pytest.mark.parametrize("word", [ControlMessage(READY), ControlMessage(CERTIFICATE, (b"pem",))])
def test_a_word_is_written_and_read(word: ControlMessage) -> None:
    frame = write(word)
    assert int.from_bytes(frame[:4]) == len(frame) - 4
    assert read(frame[4:]) == word
    for size in range(len(frame) - 4):
        with pytest.raises(KeyMessageRefused):
            read(frame[4 : 4 + size])
    with pytest.raises(KeyMessageRefused):
        read(frame[4:] + b"\0")


@pytest.mark.parametrize("value", [[], ["no"], ["ready", 1], ["certificate"], ["certificate", "a"], 1])
def test_others_are_not_in_the_table(value: object) -> None:
    with pytest.raises(KeyMessageRefused):
        read(encode(value))  # type: ignore[arg-type]
