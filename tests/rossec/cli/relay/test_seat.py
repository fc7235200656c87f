"""`rossec relay seat`."""

from pathlib import Path

from rossec.overlay.documents import Routers
from rossec.overlay.homes import RelayFiles
from tests.support.commands import Shell, refused
from tests.support.site import Site

ROUTERS = Routers(("tcp/127.0.0.1:7447",), "home", "p" * 22)


def test_the_seat_file_is_kept(empty: Shell, tmp_path: Path) -> None:
    home = Site(empty.root).enroll("/relay")
    file = tmp_path / "home.seat"
    file.write_bytes(ROUTERS.write())
    said = empty("relay", "seat", str(file))
    assert said.out == "seat home at tcp/127.0.0.1:7447\n"
    assert "whoever has it has the seat" in said.err
    assert "cards" not in said.err
    assert RelayFiles(home).routers() == ROUTERS
    file.write_bytes(Routers(ROUTERS.locators, "attic", "q" * 22).write())
    assert "hand out the cards again" in empty("relay", "seat", str(file)).err
    file.write_bytes(b"{}")
    refused(empty("relay", "seat", str(file)), "seat file")


def test_a_card_without_a_seat(empty: Shell) -> None:
    Site(empty.root).enroll("/relay")
    refused(empty("relay", "card", "x"), "/relay has no seat at a router", "rossec relay seat FILE")
