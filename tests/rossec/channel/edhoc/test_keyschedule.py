import hashlib

import pytest
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.kdf.hkdf import HKDF, HKDFExpand

from ca.encoding import encode
from rossec.channel.edhoc.suites import (
    EdhocExporter,
    KdfLabel,
    Secret,
    bstr,
    extract,
    kdf,
    transcript_2,
    transcript_next,
)


@pytest.mark.parametrize("length", [0, 1, 23, 24, 255, 256, 65535, 65536])
def test_the_fast_path_of_a_byte_string(length: int) -> None:
    assert bstr(bytes(length)) == encode(bytes(length))


@pytest.mark.parametrize("length", [1, 13, 16, 32, 33, 64, 8160])
def test_expand_is_hkdf_expand(length: int) -> None:
    info = b"info"
    expected = HKDFExpand(hashes.SHA256(), length, info).derive(b"k" * 32)
    secret = Secret(b"k" * 32)
    assert secret.expand(info, length) == secret.expand(info, length) == expected


def test_extract_and_expand_are_hkdf() -> None:
    whole = HKDF(hashes.SHA256(), 42, b"salt", b"info").derive(b"secret")
    assert extract(b"salt", b"secret").expand(b"info", 42) == whole


def test_kdf_has_the_info_of_the_rfc() -> None:
    info = encode(32768) + encode(b"context") + encode(32)
    assert kdf(Secret(b"k" * 32), 32768, b"context", 32) == Secret(b"k" * 32).expand(info, 32)


def test_an_exporter_hides_its_secret_and_updates() -> None:
    exporter = EdhocExporter(b"k" * 32)
    assert repr(exporter) == "Exporter(...)"
    assert exporter.update(b"") == exporter.update(b"")
    assert exporter.update(b"a") != exporter.update(b"b")
    assert exporter.export(1, b"", 16) != exporter.export(2, b"", 16)
    assert exporter.export(1, b"a", 16) != exporter.export(1, b"b", 16)


def test_transcripts_hash_the_bytes_as_they_travelled() -> None:
    digest = hashlib.sha256(b"message_1").digest()
    assert transcript_2(b"g" * 32, b"message_1") == sha256(encode(b"g" * 32), encode(digest))
    following = transcript_next(b"t" * 32, b"plaintext", b"credential")
    assert following == sha256(encode(b"t" * 32), b"plaintext", b"credential")


def sha256(*parts: bytes) -> bytes:
    return hashlib.sha256(b"".join(parts)).digest()


def test_what_is_derived_for_one_purpose_is_not_that_of_another() -> None:
    secret = Secret(b"k" * 32)
    derived = EdhocExporter.derive(secret, b"th_4")
    assert derived.prk_out == kdf(secret, KdfLabel.PRK_OUT, b"th_4", 32)
    assert derived.bare() == derived
    assert derived.export(1, b"", 16) == derived.bare().export(1, b"", 16)
