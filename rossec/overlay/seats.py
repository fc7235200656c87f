"""Seats at the routers of one operator: who may connect, and what each may do there. Pure.

A seat may read the mailboxes below its own name and send to any mailbox; everything else is denied:
reading others', asking which mailboxes exist, queries, presence, Zenoh's own administration. The
routers know each other by a user that no seat can be called, and by their TLS authority: the side
that connects is not told a user (`rossec.overlay.router_settings`).
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

from rossec.errors import ConfigurationError
from rossec.overlay.documents import read_document, write_document
from rossec.overlay.routers import OPEN_SEAT, check_password, check_seat

MAX_FILE: Final = 256 * 1024
MAX_SEATS: Final = 512  # each costs two rules, which a router looks through for every new session
ROUTER_USER: Final = "_router"  # no seat's name has this character
ROUTER_NAME: Final = "rossec router"  # common name of every router's certificate
EVERY_MAILBOX: Final = "rossec/1/*/*"  # two segments: a put to rossec/** fits no rule
_FORM: Final = "rossec-seats"
_HINT: Final = "it is written by `rossec router seats`: put back a copy"
_SEND: Final = "send"
_ACCEPTED: Final = "router-accepted"
_JOINED: Final = "router-joined"
_FORWARD: Final = ("forward", "forward-declared")

Entry = dict[str, Any]


@dataclass(frozen=True)
class Seats:
    """The seats with their passwords.

    Attributes:
        router: the password by which the operator's routers join each other.
        passwords: of each seat, by its name.
    """

    router: str = field(repr=False)
    passwords: Mapping[str, str] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        """Raise `ConfigurationError` unless all of it is in form."""
        check_password(self.router)
        if len(self.passwords) > MAX_SEATS:
            raise ConfigurationError(f"at most {MAX_SEATS} seats", "remove what nobody uses")
        for seat, password in self.passwords.items():
            _check_own(seat)
            check_password(password)

    @property
    def region(self) -> str:
        """The name of the region of the operator's routers, which all of them derive alike."""
        return hashlib.sha256(b"rossec region " + self.router.encode()).hexdigest()[:32]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the seats, sorted."""
        return tuple(sorted(self.passwords))

    @classmethod
    def read(cls, data: bytes) -> Self:
        """The content of the file.

        Raises:
            ConfigurationError: it is not one.
        """
        found = read_document(
            data, _FORM, frozenset({"router", "seats"}), limit=MAX_FILE, hint=_HINT
        )
        match found:
            case {"router": str() as router, "seats": dict() as seats} if all(
                isinstance(each, str) for each in seats.values()
            ):
                return cls(router, seats)
        raise ConfigurationError(f"the {_FORM} file has a value of another type", _HINT)

    def write(self) -> bytes:
        """The file: it holds all passwords."""
        return write_document(_FORM, {"router": self.router, "seats": dict(self.passwords)})

    def add(self, seat: str, password: str) -> Self:
        """These and a new one.

        Raises:
            ConfigurationError: no name for a seat, one that is there, or one too many.
        """
        if seat in self.passwords:
            raise ConfigurationError(
                f"there is a seat {seat} already",
                f"its file again: rossec router seats show {seat}; a new password: remove it first",
            )
        return replace(self, passwords={**self.passwords, seat: password})

    def remove(self, seat: str) -> Self:
        """These without one.

        Raises:
            ConfigurationError: there is none of this name.
        """
        self.password(seat)
        return replace(
            self, passwords={name: each for name, each in self.passwords.items() if name != seat}
        )

    def password(self, seat: str) -> str:
        """Of one seat.

        Raises:
            ConfigurationError: there is none of this name.
        """
        if seat not in self.passwords:
            raise ConfigurationError(
                f"there is no seat {seat[:40]!a}", f"there are: {', '.join(self.names) or 'none'}"
            )
        return self.passwords[seat]

    def dictionary(self) -> bytes:
        """Zenoh's file of users and passwords."""
        users = {**self.passwords, ROUTER_USER: self.router}
        return "".join(f"{name}:{each}\n" for name, each in sorted(users.items())).encode()

    def access_control(self) -> Entry:
        """Zenoh's `access_control`, for a router that these seats use."""
        routers = [
            {"id": _ACCEPTED, "usernames": [ROUTER_USER]},
            {"id": _JOINED, "cert_common_names": [ROUTER_NAME]},
        ]
        own = [rule for seat in self.names for rule in _own_rules(seat)]
        return _access_control(
            [_rule(_SEND, "ingress", "put", EVERY_MAILBOX), *own, *_forwarding(EVERY_MAILBOX)],
            [*({"id": _subject(seat), "usernames": [seat]} for seat in self.names), *routers],
            [
                *map(_seat_policy, self.names),
                _policy(_ACCEPTED, *_FORWARD),
                _policy(_JOINED, *_FORWARD),
            ],
        )


def open_access_control() -> Entry:
    """Zenoh's `access_control` of a router without seats: all have one, and nothing but that."""
    return _access_control(
        _forwarding(_mailboxes(OPEN_SEAT)),
        [{"id": "everybody"}],
        [_policy("everybody", *_FORWARD)],
    )


def _check_own(seat: str) -> None:
    if check_seat(seat) == OPEN_SEAT:
        raise ConfigurationError(
            f"{OPEN_SEAT} is the seat at a router without seats", "give it another name"
        )


def _access_control(rules: list[Entry], subjects: list[Entry], policies: list[Entry]) -> Entry:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _own_rules(seat: str) -> list[Entry]:
    """What only this seat may: declare that it reads a mailbox of its own, and get what is there.

    Nothing allows that a declaration goes out to it: it would name a mailbox of another seat, or
    tell by a pattern whether there is one that begins so, and with that all digits of it in turn.
    """
    return [
        _rule(f"read-{seat}", "ingress", "declare_subscriber", _mailboxes(seat)),
        _rule(f"get-{seat}", "egress", "put", _mailboxes(seat)),
    ]


def _seat_policy(seat: str) -> Entry:
    return _policy(_subject(seat), _SEND, f"read-{seat}", f"get-{seat}")


def _forwarding(keys: str) -> list[Entry]:
    """What routers may do for each other."""
    put, declare = _FORWARD
    return [
        _rule(put, "both", "put", keys),
        _rule(declare, "both", "declare_subscriber", keys),
    ]


def _mailboxes(seat: str) -> str:
    return f"rossec/1/{seat}/*"


def _subject(seat: str) -> str:
    return f"seat-{seat}"


def _rule(name: str, flow: str, message: str, keys: str) -> Entry:
    flows = ["ingress", "egress"] if flow == "both" else [flow]
    return {
        "id": name,
        "permission": "allow",
        "flows": flows,
        "messages": [message],
        "key_exprs": [keys],
    }


def _policy(subject: str, *rules: str) -> Entry:
    return {"rules": list(rules), "subjects": [subject]}
