"""`rossec relay account`."""

from pathlib import Path

from rossec.overlay.documents import Routers
from rossec.overlay.homes import RelayFiles
from tests.support.commands import Shell, refused
from tests.support.site import Site

ROUTERS = Routers(("tcp/127.0.0.1:7447",), "home", "p" * 22)


def test_the_account_file_is_kept(empty: Shell, tmp_path: Path) -> None:
    home = Site(empty.root).enroll("/relay")
    file = tmp_path / "home.account"
    file.write_bytes(ROUTERS.write())
    said = empty("relay", "account", str(file))
    assert said.out == "account home at tcp/127.0.0.1:7447\n"
    assert "whoever has it has the account" in said.err
    assert "descriptors" not in said.err
    assert RelayFiles(home).routers() == ROUTERS
    file.write_bytes(Routers(ROUTERS.locators, "attic", "q" * 22).write())
    assert "hand out the descriptors again" in empty("relay", "account", str(file)).err
    file.write_bytes(b"{}")
    refused(empty("relay", "account", str(file)), "account file")


def test_a_descriptor_without_an_account(empty: Shell) -> None:
    Site(empty.root).enroll("/relay")
    refused(
        empty("relay", "descriptor", "x"), "/relay has no account at a router", "rossec relay account FILE"
    )
