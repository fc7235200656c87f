import json

from rossec.overlay.documents import Routers
from tests.support.commands import Shell, refused

HOST = ("--host", "router.example.org")


def test_a_seat_is_made_shown_listed_and_removed(empty: Shell) -> None:
    made = empty("router", "seats", "add", "home", *HOST)
    assert made.code == 0
    seat = Routers.read(made.out.encode())
    assert (seat.seat, seat.locators) == ("home", ("tls/router.example.org:7447",))
    assert empty("router", "seats", "show", "home").out == made.out
    assert empty("router", "seats", "list").out == "home\n"
    assert json.loads(empty("router", "seats", "list", "--json").out) == {"seats": ["home"]}
    assert empty("router", "seats", "remove", "home").out == "the seat home is no more\n"
    assert "nobody has a seat" in empty("router", "seats", "list").err
    assert Routers.read(empty("router", "seats", "add", "home").out.encode()) != seat


def test_the_password_is_only_in_the_seat_file(empty: Shell) -> None:
    password = Routers.read(empty("router", "seats", "add", "home", *HOST).out.encode()).password
    for words in (("seats", "list"), ("seats", "add", "home"), ("seats", "remove", "home")):
        said = empty("router", *words)
        assert password not in said.out + said.err


def test_the_seat_of_everybody(empty: Shell) -> None:
    seat = Routers.read(empty("router", "seats", "show", "open", *HOST).out.encode())
    assert (seat.seat, seat.password) == ("open", "")
    refused(empty("router", "seats", "add", "open"), "open is the seat at a router without seats")


def test_what_cannot_be_done_with_seats(empty: Shell) -> None:
    refused(empty("router", "seats", "list"), "there is no", "rossec router seats add")
    refused(empty("router", "seats", "add", "home"), "by which name relays reach", "--host")
    assert empty("router", "seats", "list").out == ""
    refused(empty("router", "seats", "add", "Home", *HOST), "'Home' is not the name of a seat")
    refused(empty("router", "seats", "add", "home", "--host", "a b"), "is not the address")
    assert empty("router", "seats", "add", "home", *HOST).code == 0
    refused(empty("router", "seats", "add", "home"), "there is a seat home already", "seats show")
    refused(empty("router", "seats", "show", "hall"), "there is no seat 'hall'", "there are: home")
    refused(empty("router", "seats", "remove", "hall"), "there is no seat 'hall'")


def test_a_router_that_never_ran_is_told_where_it_will_listen(empty: Shell) -> None:
    words = "--listen", "tls/[::]:443", "--listen", "quic/[::]:443"
    said = empty("router", "seats", "add", "home", *HOST, *words)
    locators = Routers.read(said.out.encode()).locators
    assert locators == ("tls/router.example.org:443", "quic/router.example.org:443")
    wrong = empty("router", *words, "seats", "list")
    assert (wrong.code, "only --home stands before a verb" in wrong.err) == (2, True)


def test_another_directory(empty: Shell) -> None:
    home = str(empty.root / "second")
    assert empty("router", "--home", home, "seats", "add", "clinic", *HOST).code == 0
    assert empty("router", "--home", home, "seats", "list").out == "clinic\n"
    assert not (empty.root / "router").exists()
