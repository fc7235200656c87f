import json

import pytest

from rossec.errors import ConfigurationError
from rossec.overlay.router_settings import MAX_SEATS, ROUTER_USER, Seats, open_access_control

ROUTER = "r" * 43
HOME = "h" * 43
CLINIC = "c" * 43


@pytest.fixture
def seats() -> Seats:
    return Seats(ROUTER).add("home", HOME).add("clinic", CLINIC)


def test_seats_are_read_as_they_were_written(seats: Seats) -> None:
    assert Seats.read(seats.write()) == seats
    assert seats.names == ("clinic", "home")
    assert seats.password("home") == HOME


def test_seats_come_and_go(seats: Seats) -> None:
    assert seats.remove("clinic").names == ("home",)
    assert seats.names == ("clinic", "home")
    with pytest.raises(ConfigurationError, match="there is a seat home already") as caught:
        seats.add("home", HOME)
    assert "rossec router seats show home" in caught.value.hint
    with pytest.raises(ConfigurationError, match="there is no seat 'hall'") as caught:
        seats.remove("hall")
    assert caught.value.hint == "there are: clinic, home"


@pytest.mark.parametrize("name", ["open", "Home", ROUTER_USER, "a/b", "*", ""])
def test_what_cannot_be_a_seat(seats: Seats, name: str) -> None:
    with pytest.raises(ConfigurationError):
        seats.add(name, HOME)


def test_there_are_not_more_seats_than_a_router_bears() -> None:
    full = Seats(ROUTER, {f"seat{number}": HOME for number in range(MAX_SEATS)})
    assert Seats.read(full.write()) == full
    with pytest.raises(ConfigurationError, match="at most 512 seats"):
        full.add("one", HOME)


def test_no_password_is_shown(seats: Seats) -> None:
    assert not {word for word in (ROUTER, HOME, CLINIC) if word in repr(seats)}


@pytest.mark.parametrize(
    "change",
    [
        {"router": 1},
        {"router": "short"},
        {"seats": []},
        {"seats": {"home": 1}},
        {"seats": {"home": "short"}},
        {"seats": {"open": HOME}},
        {"seats": {"home:x\nevil": HOME}},
        {"more": 1},
    ],
)
def test_a_file_with_anything_else_is_refused(seats: Seats, change: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        Seats.read(json.dumps(json.loads(seats.write()) | change).encode())


def test_the_users_of_zenoh(seats: Seats) -> None:
    assert seats.dictionary().decode().splitlines() == [
        f"_router:{ROUTER}",
        f"clinic:{CLINIC}",
        f"home:{HOME}",
    ]


def test_a_seat_sends_to_all_and_reads_its_own(seats: Seats) -> None:
    control = seats.access_control()
    assert control["default_permission"] == "deny"
    (subject,) = (each for each in control["subjects"] if each.get("usernames") == ["home"])
    (policy,) = (each for each in control["policies"] if each["subjects"] == [subject["id"]])
    rules = [each for each in control["rules"] if each["id"] in policy["rules"]]
    assert [(each["flows"], each["messages"], each["key_exprs"]) for each in rules] == [
        (["ingress"], ["put"], ["rossec/1/*/*"]),
        (["ingress"], ["declare_subscriber"], ["rossec/1/home/*"]),
        (["egress"], ["put"], ["rossec/1/home/*"]),
    ]


def test_routers_are_known_by_their_user_or_by_their_certificate(seats: Seats) -> None:
    control = seats.access_control()
    forwarding = [policy["subjects"][0] for policy in control["policies"] if "forward" in policy["rules"]]
    subjects = {each["id"]: each for each in control["subjects"]}
    assert [{**subjects[each], "id": ""} for each in forwarding] == [
        {"id": "", "usernames": [ROUTER_USER]},
        {"id": "", "cert_common_names": ["rossec router"]},
    ]


def test_at_an_open_router_there_is_one_seat() -> None:
    control = open_access_control()
    assert control["default_permission"] == "deny"
    assert {key for each in control["rules"] for key in each["key_exprs"]} == {"rossec/1/open/*"}
