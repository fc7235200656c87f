"""`rossec border labels`."""

from pathlib import Path

from ca.enrollment import qr
from ca.things import ThingKey, ThingSecret
from rossec.authority.home import format_fingerprint
from tests.support.commands import Shell, refused
from tests.support.pki import new_signer

SECRET = bytes(range(16))


def test_a_sheet_names_credentials_and_holds_no_secret(empty: Shell, tmp_path: Path) -> None:
    key, known = ThingKey.of(new_signer().public_key, b"1", "lamp <3"), ThingSecret.of(SECRET, b"2")
    paths = [tmp_path / "first.ccs", tmp_path / "thermometer.psk"]
    for path, data in zip(paths, (key.ccs, known.description), strict=True):
        path.write_bytes(data)
    out = tmp_path / "labels.html"
    said = empty("border", "labels", *map(str, paths), "--out", str(out))
    assert said.out == f"2 labels in {out}: print it without scaling\n"
    page = out.read_text()
    assert "lamp &lt;3" in page
    assert "thermometer" in page
    assert format_fingerprint(key.thumbprint)[:10] in page
    assert SECRET.hex() not in page.lower()
    assert qr.parse(qr.label_code(key.ccs)).matches(key.ccs)


def test_a_secret_is_no_credential(empty: Shell, tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_bytes(SECRET)
    said = empty("border", "labels", str(path), "--out", str(tmp_path / "labels.html"))
    refused(said, "not a credential of a thing")
    assert not (tmp_path / "labels.html").exists()
