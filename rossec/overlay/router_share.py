"""What the routers of one operator share: the TLS authority with its key, the seats. Pure.

It is a file that one router writes and another takes over. All of it is secret; with it one is the
operator.
"""

from dataclasses import dataclass, field
from typing import Final, Self

from rossec.errors import ConfigurationError
from rossec.overlay import seats
from rossec.overlay.documents import is_texts, read_document, write_document
from rossec.overlay.router_tls import RouterAuthority, key_pem
from rossec.overlay.routers import MAX_LOCATORS, check_locator
from rossec.overlay.seats import Seats

MAX_FILE: Final = 2 * seats.MAX_FILE
_FORM: Final = "rossec-routers"
_KEYS: Final = frozenset({"authority_key", "authority", "seats", "join"})
_HINT: Final = "write it again, at the other router: rossec router share"


@dataclass(frozen=True)
class Share:
    """What a further router needs.

    Attributes:
        authority: certifies the routers.
        seats: with their passwords.
        join: where the router listens that wrote it, and those that it joins itself.
    """

    authority: RouterAuthority = field(repr=False)
    seats: Seats
    join: tuple[str, ...]

    def write(self) -> bytes:
        """The file."""
        return write_document(
            _FORM,
            {
                "authority_key": key_pem(self.authority.key).decode(),
                "authority": self.authority.pem.decode(),
                "seats": self.seats.write().decode(),
                "join": list(self.join),
            },
        )

    @classmethod
    def read(cls, data: bytes) -> Self:
        """The content of the file.

        Raises:
            ConfigurationError: it is not one.
        """
        found = read_document(data, _FORM, _KEYS, limit=MAX_FILE, hint=_HINT)
        match found:
            case {
                "authority_key": str() as key, "authority": str() as pem, "seats": str() as listed,
                "join": list() as join,
            } if is_texts(join) and 0 < len(join) <= MAX_LOCATORS:  # fmt: skip
                authority = RouterAuthority.load(key.encode(), pem.encode())
                for each in join:
                    check_locator(each)
                return cls(authority, Seats.read(listed.encode()), tuple(join))
        raise ConfigurationError(f"the {_FORM} file has a value of another type", _HINT)
