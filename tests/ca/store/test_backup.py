from pathlib import Path

import pytest

from ca.encoding import Value, encode
from ca.errors import CAError, PassphraseRefused
from ca.keys import passphrases
from ca.keys.passphrases import seal, unseal

FILES = {"ca.db": bytes(100_000), "node/node.key": b"key", "inbox/1.request": b"", "ca.key": b"k"}
WORDS, SALT, NONCE = "four random words here", b"s" * 16, b"n" * 12


def sealed(files: dict[str, bytes] | None = None, words: str = WORDS) -> bytes:
    return seal(FILES if files is None else files, words, salt=SALT, nonce=NONCE)


DATA = sealed()


def test_a_backup_round_trip() -> None:
    assert unseal(DATA, WORDS) == FILES
    assert b"node.key" not in DATA


def test_a_wrong_passphrase_says_so() -> None:
    with pytest.raises(PassphraseRefused, match="does not open the backup") as caught:
        unseal(DATA, WORDS + ".")
    assert "try again" in caught.value.hint
    with pytest.raises(PassphraseRefused, match="the passphrase is empty"):
        unseal(DATA, "")
    with pytest.raises(PassphraseRefused, match="the passphrase is empty"):
        sealed(words="")


@pytest.mark.parametrize("place", [16, 32, 44, -1])
def test_every_byte_counts(place: int) -> None:
    """Salt, nonce, ciphertext, tag."""
    changed = bytearray(DATA)
    changed[place] ^= 1
    with pytest.raises(PassphraseRefused):
        unseal(bytes(changed), WORDS)


@pytest.mark.parametrize("data", [b"", b"tar", DATA[:43], b"x" + DATA])
def test_a_file_that_is_not_a_backup_is_refused(data: bytes) -> None:
    with pytest.raises(CAError, match="this is not a backup of an authority"):
        unseal(data, WORDS)


def test_a_truncated_or_extended_backup_is_refused() -> None:
    for data in (DATA[:44], DATA[:-1], DATA + b"\0"):
        with pytest.raises(PassphraseRefused):
            unseal(data, WORDS)


@pytest.mark.parametrize(
    "name", ["", "..", "../ca.key", "/etc/passwd", "node/../x", "a/b/c/d/e", ".hidden", "a\0", "é"]
)
def test_names_stay_inside(name: str, tmp_path: Path) -> None:
    with pytest.raises(CAError, match="is not a file of an authority"):
        sealed({name: b""})


def forged(value: Value, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """What a stranger who knows the passphrase could seal."""
    with monkeypatch.context() as patched:
        patched.setattr(passphrases, "encode", lambda _: value if isinstance(value, bytes) else encode(value))
        patched.setattr(passphrases, "_check_names", lambda _: None)
        return sealed()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (b"\xff", "the backup is malformed: malformed CBOR"),
        ([], "no files in it"),
        ({"ca.key": 1}, "a file without content"),
        ({"../ca.key": b""}, "is not a file of an authority"),
    ],
)
def test_malformed_content_of_a_backup_is_refused(
    value: Value, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = forged(value, monkeypatch)
    with pytest.raises(CAError, match=message):
        unseal(data, WORDS)


def test_too_large_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passphrases, "MAX_BACKUP", 90_000)
    with pytest.raises(CAError, match="too large for one backup"):
        sealed()
    with pytest.raises(CAError, match="this is not a backup"):
        unseal(DATA, WORDS)
