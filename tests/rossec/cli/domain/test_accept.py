"""A bundle is shown, compared and accepted; what is refused changes nothing."""

import io
from pathlib import Path

import pytest

from ca.enrollment import qr
from tests.rossec.cli.domain.sites import NOBODY, Neighbours
from tests.support.commands import Shell, refused


def test_a_bundle_is_shown_and_accepted(sites: Neighbours) -> None:
    said = sites.accept(
        "--admit", "/rounds/*", "--fresh", "90s", "--for", "30d", "--export", "/robot/** subscribe,call"
    )
    refused_delivery = said.err.splitlines()
    assert f"  fingerprint {sites.fingerprint}" in said.out
    for line in (
        "domain hospital.example, here hospital:/... and /remote/hospital",
        "  admits /rounds/*, and its masters and relays",
        "  its word on its revocations may be 90s old",
        "  shown to it: /robot/** (subscribe, call)",
        "  taken from it: whatever grants allow",
        "  its master is at http://10.0.0.7:11311",
        "  no code was checked: compare the fingerprint with the one its authority shows",
        "hospital.example is trusted as hospital (list of domains 1)",
    ):
        assert line in said.out.splitlines(), line
    assert any("this is one way" in line for line in refused_delivery)
    assert any("rossec domain accept home.bundle --as LABEL" in line for line in refused_delivery)
    assert said.code == 3
    assert "did not take the list of domains" in said.err
    (entry,) = sites.listed().domains
    assert entry.admitted == ("/master", "/master/*", "/relay", "/relay/*", "/rounds/*")
    assert (entry.label, entry.fresh) == ("hospital", 90)
    assert (entry.exported, entry.imported) == ((("/robot/**", 6),), None)
    assert sites.shell("ca", "log", "verify").code == 0


def test_without_admit_the_names_of_the_bundle_are_admitted(sites: Neighbours) -> None:
    sites.accept("--as", "clinic")
    (entry,) = sites.listed().domains
    assert entry.admitted == ("/master", "/master/*", "/relay", "/relay/*", "/rounds/**")
    assert entry.label == "clinic"


def test_the_code_or_the_fingerprint_says_which_bundle_is_meant(sites: Neighbours) -> None:
    for proof in (("--code", sites.code), ("--fingerprint", sites.fingerprint.upper())):
        said = sites.accept(*proof)
        assert "this is the bundle that was meant" in said.out
    other = sites.make_bundle("--names", "/other/**")
    assert other.code == 0
    refused(sites.accept("--code", sites.code), "the bundle does not fit the code", "take the file")
    refused(sites.accept("--code", "x"), "not the code of a bundle", "rossec domain bundle --qr")
    wrong = sites.fingerprint.replace(sites.fingerprint[0], "x")
    refused(sites.accept("--fingerprint", wrong), "the fingerprint of the bundle is", "another auth")
    assert sites.listed().seq == 2


def test_the_code_is_read_from_a_picture(sites: Neighbours, tmp_path: Path) -> None:
    picture = tmp_path / "code.png"
    picture.write_bytes(qr.png(sites.code))
    assert "the bundle that was meant" in sites.accept("--image", str(picture)).out


def test_nothing_is_accepted_without_an_answer(sites: Neighbours, monkeypatch: pytest.MonkeyPatch) -> None:
    accept = ("domain", "accept", str(sites.bundle), *NOBODY)
    for answer, message in (("", "there was no answer"), ("n\n", "nothing was done")):
        monkeypatch.setattr("sys.stdin", io.StringIO(answer))
        said = sites.shell.unlocked(*accept)
        assert said.code == 1
        assert message in said.err
    assert sites.home.domain_list() is None
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert "is trusted as hospital" in sites.shell.unlocked(*accept).out


@pytest.mark.parametrize(
    ("options", "error", "hint"),
    [
        (("--as", "two words"), "is not a label", "one word"),
        (("--admit", "rounds"), "not a name pattern", "* stands for"),
        (("--fresh", "10s"), "--fresh 10s is too short", "at least 30s"),
        (("--export", "/a"), "is not a pattern and its rights", "subscribe"),
        (("--export", "/a fly"), "'fly' is not a right", "publish"),
        (("--import", "a subscribe"), "not a name pattern", ""),
    ],
)
def test_terms_that_are_none(sites: Neighbours, options: tuple[str, ...], error: str, hint: str) -> None:
    refused(sites.accept(*options), error, hint)
    assert sites.home.domain_list() is None


def test_a_file_that_is_no_bundle(sites: Neighbours) -> None:
    sites.bundle.write_bytes(b"something else")
    refused(sites.accept(), "this is not a domain's bundle", "rossec domain bundle")
    sites.bundle.write_bytes(bytes(100_000))
    assert sites.accept().code == 1


def test_a_domain_accepted_again_keeps_its_label(sites: Neighbours) -> None:
    sites.accept("--as", "clinic")
    said = sites.accept("--for", "9d")
    assert "it is trusted already: these terms replace those of before" in said.out
    assert [each.label for each in sites.listed().domains] == ["clinic"]
    refused(sites.accept("--as", "ward"), "is called clinic here", "--as clinic")


def test_a_domain_whose_name_is_no_label_needs_one(
    sites: Neighbours, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = Shell(tmp_path / "other", capsys)
    assert other.unlocked("ca", "init", "3rd-floor").code == 0
    assert other.unlocked("domain", "bundle", "--out", str(sites.bundle)).code == 0
    refused(sites.accept(), "domain 3rd-floor needs a name here", "--as")
    assert "trusted as third" in sites.accept("--as", "third").out


def test_what_cannot_be_accepted_is_refused_before_anybody_is_asked(sites: Neighbours) -> None:
    own = sites.shell.root / "own.bundle"
    assert sites.shell.unlocked("domain", "bundle", "--out", str(own)).code == 0
    said = sites.shell.unlocked("domain", "accept", str(own), "--as", "me")
    refused(said, "this is the bundle of home, the own domain", "the other authority")
    sites.accept()
    said = sites.shell.unlocked("domain", "accept", str(sites.bundle), "--as", "clinic")
    refused(said, "is called hospital here", "--as hospital")
    assert "fingerprint" not in said.out
