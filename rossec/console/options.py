"""Where the console listens, and what a browser calls it. Pure: options in, an endpoint out.

A passkey belongs to a name (the RP id, WebAuthn section 5.1.2) and is recorded with the origin it was made
at: so there is one origin, it is known before anything listens, and another one means new passkeys. A name is
a DNS name: browsers refuse addresses as RP ids ("invalid domain").
"""

import ipaddress
import re
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from rossec.errors import ConfigurationError

PORT: Final = 7411
HAND_OUT_PORT: Final = 7410
MAX_PHONE_NAME: Final = 40  # characters: it is shown in one line
LOCALHOST: Final = "localhost"
_LOOPBACK: Final = ("127.0.0.1", "::1")
_EVERY: Final = ("0.0.0.0", "::")  # noqa: S104 - what --lan asks for; who may see it, sessions say
_MAX_NAME: Final = 253
# RFC 1123 section 2.1. The last label is not a number: URLs would take it for an IPv4 address.
_LABEL: Final = r"[a-z0-9](?:[a-z0-9-]{0,61}[a-z0-9])?"
_NAME: Final = re.compile(rf"(?:{_LABEL}\.)*(?![0-9]+\Z){_LABEL}", re.ASCII)
_DEFAULT_PORTS: Final = {"http": 80, "https": 443}


class Tls(StrEnum):
    NONE = "none"  # plain HTTP: on this host alone, or behind a proxy
    OWN = "own"  # the console's own TLS authority
    FILES = "files"  # --tls-cert and --tls-key


@dataclass(frozen=True)
class ConsoleOptions:
    lan: bool = False
    name: str | None = None
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    unix_path: Path | None = None
    origin: str | None = None
    proxy_user: str | None = None
    port: int | None = None
    read_only: bool = False
    hand_out: bool = False
    preview: bool = False


@dataclass(frozen=True)
class ConsoleEndpoint:
    origin: str  # as browsers send it, such as `https://rossec.local:7411`
    name: str  # the host of `origin`, to which passkeys belong
    addresses: tuple[str, ...] = ()  # to listen at; none if `unix_path` is set
    port: int = 0
    unix_path: Path | None = None
    proxy_user: str | None = None  # who connects to `unix_path`; None: the user of the console
    tls: Tls = Tls.NONE
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    read_only: bool = False  # nothing but looking; no code that could do more is there
    hand_out: bool = False  # for ten minutes, the certificate of the own TLS authority

    @property
    def is_local(self) -> bool:
        return self.unix_path is not None or self.addresses == _LOOPBACK

    @property
    def hsts(self) -> bool:
        return self.tls is Tls.FILES


def read_options(options: ConsoleOptions, hostname: str) -> ConsoleEndpoint:
    # 1. Options that do not go together.
    has_files = options.tls_certificate is not None or options.tls_key is not None
    ways, is_proxied = (options.lan, has_files), options.unix_path is not None
    no_pair = has_files and None in {options.tls_certificate, options.tls_key, options.name}
    to_lan = "--hand-out is for --lan: only there is a TLS authority to hand out"
    both = "--unix PATH --origin https://NAME, as browsers see it"
    files = "give all of --tls-cert FILE --tls-key FILE --name NAME"
    proxy_user = options.proxy_user is not None and not is_proxied
    name_for = "--name is for --lan and --tls-cert", "without them browsers call it localhost"
    for conflict, message, hint in (
        (sum(ways) + is_proxied > 1, "--lan, --tls-cert and --unix exclude each other", "choose one"),
        (no_pair, "a certificate needs its key and its name", files),
        (is_proxied != (options.origin is not None), "a proxy needs both --unix and --origin", both),
        (proxy_user, "--proxy-user is for --unix", "it is the user who may connect to the socket"),
        (options.name is not None and not any(ways), *name_for),
        (options.hand_out and not options.lan, to_lan, "add --lan"),
        (options.port is not None and is_proxied, "--port is not for --unix", "the proxy has the port"),
    ):
        if conflict:
            raise ConfigurationError(message, hint)
    # 2. Behind a proxy the origin is the proxy's; headers that a proxy adds are never read.
    if options.unix_path is not None:
        return _behind_proxy(options, options.unix_path)
    port = PORT if options.port is None else options.port
    if not 0 < port < 1 << 16:
        raise ConfigurationError(f"{port} is not a port", "give one from 1 to 65535")
    # 3. On this host alone: plain HTTP, which browsers trust at localhost (a secure context).
    if not any(ways):
        host = _with_port(LOCALHOST, "http", port)
        return ConsoleEndpoint(f"http://{host}", LOCALHOST, _LOOPBACK, port, read_only=options.read_only)
    # 4. For other devices, by the name that is given, or `<hostname>.local`, as mDNS announces it (RFC 6762
    # section 3).
    try:
        own = f"{hostname.partition('.')[0].lower()}.local"
        name = check_name(own if options.name is None else options.name)
    except ConfigurationError as error:
        if options.name is not None:
            raise
        said = f"the name of this host, {hostname!a}, is not a DNS name"
        raise ConfigurationError(said, "give one: --name NAME.local") from error
    if name == LOCALHOST:
        hint = "give the name of this host: --name NAME.local"
        raise ConfigurationError("no other device can reach localhost", hint)
    return ConsoleEndpoint(
        f"https://{_with_port(name, 'https', port)}",
        name,
        _EVERY,
        port,
        tls=Tls.OWN if options.lan else Tls.FILES,
        tls_certificate=options.tls_certificate,
        tls_key=options.tls_key,
        read_only=options.read_only,
        hand_out=options.hand_out,
    )


def check_name(name: str) -> str:
    with suppress(ValueError):
        ipaddress.ip_address(name.strip("[]"))
        raise ConfigurationError(
            f"{name} is an address: a passkey cannot belong to one",
            "give a name, such as --name rossec.local",
        )
    found = name.lower()
    if len(found) > _MAX_NAME or not _NAME.fullmatch(found) or found == "local":
        raise ConfigurationError(
            f"{name!a} is not a DNS name",
            "letters, digits and hyphens between dots, such as --name rossec.local",
        )
    return found


def check_origin(endpoint: ConsoleEndpoint, recorded: Collection[str], *, rename: bool) -> None:
    """Check that the passkeys that exist, made at the origins `recorded`, can approve here."""
    if rename or not recorded or endpoint.origin in recorded:
        return
    others = ", ".join(sorted(recorded))
    raise ConfigurationError(
        f"the phones' passkeys belong to {others} and cannot approve at {endpoint.origin}",
        "start it with the options of before; or add --rename and register every phone anew",
    )


def _behind_proxy(options: ConsoleOptions, path: Path) -> ConsoleEndpoint:
    origin = options.origin or ""
    try:
        parts = urlsplit(origin)
        scheme, name, port = parts.scheme, parts.hostname or "", parts.port
    except ValueError as error:
        raise _origin_refused(origin) from error
    plain = f"{scheme}://{parts.netloc}"
    if origin.rstrip("/") != plain or "@" in parts.netloc or scheme not in _DEFAULT_PORTS:
        raise _origin_refused(origin)
    name = check_name(name)
    if scheme == "http" and name != LOCALHOST:
        raise ConfigurationError(
            f"{plain} is not encrypted: browsers allow no passkey there",
            "let the proxy serve https, and give --origin https://NAME",
        )
    host = _with_port(name, scheme, port or _DEFAULT_PORTS[scheme])
    return ConsoleEndpoint(
        f"{scheme}://{host}", name, unix_path=path, proxy_user=options.proxy_user, read_only=options.read_only
    )


def _origin_refused(origin: str) -> ConfigurationError:
    return ConfigurationError(f"{origin!a} is not an origin", "write it as --origin https://ca.example.org")


def _with_port(name: str, scheme: str, port: int) -> str:
    return name if port == _DEFAULT_PORTS[scheme] else f"{name}:{port}"
