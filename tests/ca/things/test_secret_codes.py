"""The text that carries a secret to its thing."""

import pytest
import segno

from ca.errors import ThingRefused
from ca.things import parse_secret, secret_text

SECRET = bytes(range(16))


def test_what_is_written_is_read() -> None:
    text = secret_text(b"\x0a\xff", SECRET)
    assert text == "OSCORE:0AFF:000102030405060708090A0B0C0D0E0F"
    assert parse_secret(f" {text}\n") == (b"\x0a\xff", SECRET)
    assert segno.make_qr(text).mode == "alphanumeric"


@pytest.mark.parametrize(
    ("kid", "secret"), [(b"", SECRET), (bytes(8), SECRET), (b"1", b""), (b"1", bytes(17))]
)
def test_other_lengths_are_refused(kid: bytes, secret: bytes) -> None:
    with pytest.raises(ThingRefused, match="not the secret of a thing"):
        secret_text(kid, secret)


def test_every_part_of_the_text_counts() -> None:
    text = secret_text(b"\x07", SECRET)
    for other in (*(text[:at] for at in range(len(text))), text + "0", text.lower()):
        with pytest.raises(ThingRefused):
            parse_secret(other)
