"""The fingerprint of the TLS authority's certificate, in hex and in eight words. Reads its table.

What a phone shows of a certificate is the SHA-256 of its DER form in hex: that is what is compared
on the phone. The words are its first 88 bits, for saying aloud (one person at the terminal, one at
the phone that has the console open). Eight words of the PGP list would be 64 bits, which somebody
with much hardware could match; the list of BIP-39 has 11 bits a word.
"""

from functools import lru_cache
from hashlib import sha256
from importlib import resources
from typing import Final

COUNT: Final = 8
_BITS: Final = 11


def in_hex(certificate: bytes) -> str:
    """As phones and browsers show it: `A1:B2:...`, 32 pairs, of a certificate in DER."""
    return sha256(certificate).digest().hex(":").upper()


def in_words(certificate: bytes) -> str:
    """The first 88 bits as eight words."""
    number = int.from_bytes(sha256(certificate).digest(), "big")
    return " ".join(words()[number >> 256 - _BITS * place & 0x7FF] for place in range(1, COUNT + 1))


@lru_cache(maxsize=1)
def words() -> tuple[str, ...]:
    """The 2048 words of BIP-39, in their order."""
    text = (resources.files(__package__) / "words.txt").read_text("ascii")
    return tuple(line for line in text.splitlines() if not line.startswith("#"))
