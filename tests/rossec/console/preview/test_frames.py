import pytest

from ca.encoding import Value, encode
from rossec.console.preview import frames
from rossec.console.preview.memory import PreviewMessage
from rossec.errors import KeyMessageRefused

MESSAGE = PreviewMessage("/pose", "geometry_msgs/Pose", 1_800_000_000.25, b"\0" * 56)


def test_a_message_comes_back() -> None:
    data = frames.write(MESSAGE)
    head, body = data[: frames.HEAD], data[frames.HEAD :]
    assert frames.size(head) == len(body)
    assert frames.read(body) == MESSAGE


@pytest.mark.parametrize("size", [0, frames.MAX_FRAME + 1, 2**32 - 1])
def test_a_length_is_checked_before_anything_is_read(size: int) -> None:
    with pytest.raises(KeyMessageRefused):
        frames.size(size.to_bytes(frames.HEAD))


def test_every_truncated_message_is_refused() -> None:
    body = frames.write(MESSAGE)[frames.HEAD :]
    for wrong in (*(body[:size] for size in range(len(body))), body + b"\0"):
        with pytest.raises(KeyMessageRefused, match="malformed"):
            frames.read(wrong)


@pytest.mark.parametrize(
    "value",
    [[], {}, ["/t", "T", 1], ["/t", "T", -1, b""], ["/t", "T", True, b""], ["/t", "T", 1.5, b""],
     [b"/t", "T", 1, b""], ["/t", "T", 1, "x"], ["/t", "T", 1, b"", 0]],
)  # fmt: skip
def test_anything_else_is_refused(value: Value) -> None:
    with pytest.raises(KeyMessageRefused, match="malformed"):
        frames.read(encode(value))
