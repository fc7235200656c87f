from pathlib import Path

import pytest

from ca.domains import open_bundle
from ca.enrollment.qr import check_code
from rossec import clock
from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Shell, refused


def test_a_bundle_is_written_with_its_code_and_what_to_do_with_it(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = shell.unlocked("domain", "bundle", "--for", "1d")
    assert said.out.splitlines()[0] == "bundle of home: home.bundle"
    data = (tmp_path / "home.bundle").read_bytes()
    bundle = open_bundle(data, clock.now())
    assert (bundle.names, bundle.masters) == (("/**",), ())
    assert bundle.expires - bundle.issued == 86400
    check_code(said.out.splitlines()[2].removeprefix("code "), data)
    assert "there: rossec domain accept home.bundle --as LABEL" in said.err
    assert "it is two-sided" in said.err
    assert "\x1b[" not in said.err


def test_its_code_fits_on_a_terminal(sites: Neighbours) -> None:
    said = sites.make_bundle("--qr")
    picture = [line for line in said.err.splitlines() if line.startswith("\x1b[")]
    assert 10 < len(picture) < 20


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (("--at", "10.0.0.7"), "is not a master's address"),
        (("--names", "robot"), "not a name pattern"),
        (("--names", "/a") * 17, "too many names"),
    ],
)
def test_a_bundle_that_would_be_none(sites: Neighbours, options: tuple[str, ...], error: str) -> None:
    refused(sites.make_bundle(*options), error)
    assert sites.make_bundle("--for", "31d").code == 2


def test_no_bundle_without_an_authority(empty: Shell) -> None:
    refused(empty.unlocked("domain", "bundle"), "there is no authority")
