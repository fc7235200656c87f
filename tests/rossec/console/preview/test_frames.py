import pytest

from ca.encoding import Value, encode
from rossec.authority.keyservice import messages
from rossec.console import samples
from rossec.console.samples import PreviewMessage
from rossec.errors import KeyMessageRefused

MESSAGE = PreviewMessage("/pose", "geometry_msgs/Pose", 1_800_000_000.25, b"\0" * 56)


def test_a_message_comes_back() -> None:
    data = samples.write_preview(MESSAGE)
    head, body = data[: messages.HEAD], data[messages.HEAD :]
    assert samples.preview_size(head) == len(body)
    assert samples.read_preview(body) == MESSAGE


@pytest.mark.parametrize("size", [0, samples.MAX_FRAME + 1, 2**32 - 1])
def test_a_length_is_checked_before_anything_is_read(size: int) -> None:
    with pytest.raises(KeyMessageRefused):
        samples.preview_size(size.to_bytes(messages.HEAD))


def test_every_truncated_message_is_refused() -> None:
    body = samples.write_preview(MESSAGE)[messages.HEAD :]
    for wrong in (*(body[:size] for size in range(len(body))), body + b"\0"):
        with pytest.raises(KeyMessageRefused, match="malformed"):
            samples.read_preview(wrong)


@pytest.mark.parametrize(
    "value",
    [
        [],
        {},
        ["/t", "T", 1],
        ["/t", "T", -1, b""],
        ["/t", "T", True, b""],
        ["/t", "T", 1.5, b""],
        [b"/t", "T", 1, b""],
        ["/t", "T", 1, "x"],
        ["/t", "T", 1, b"", 0],
    ],
)
def test_anything_else_is_refused(value: Value) -> None:
    with pytest.raises(KeyMessageRefused, match="malformed"):
        samples.read_preview(encode(value))
