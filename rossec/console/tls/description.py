"""The TLS authority in words for a person, and as JSON. Pure."""

from rossec import clock
from rossec.console.tls import fingerprint
from rossec.console.tls.authority import DAY, TlsAuthority

SOON = 30 * DAY  # seconds before its end in which a person is told
_PAIRS = 16  # of the fingerprint in a line, as phones break it


def describe(authority: TlsAuthority, now: int) -> list[str]:
    """Lines for a terminal: what it is for, and the fingerprint to compare."""
    pairs = fingerprint.in_hex(authority.data).split(":")
    lines = [":".join(pairs[start : start + _PAIRS]) for start in range(0, len(pairs), _PAIRS)]
    return [
        f"TLS authority of the console, for {_names(authority)} alone",
        f"valid until {clock.format_time(authority.not_after)}{_warning(authority, now)}",
        "SHA-256 fingerprint, to compare with what the phone shows of the certificate:",
        *(f"    {line}" for line in lines),
        "the same in words, to say aloud:",
        f"    {fingerprint.in_words(authority.data)}",
    ]


def as_json(authority: TlsAuthority) -> dict[str, object]:
    """For programs; times are seconds since the epoch."""
    return {
        "name": authority.name,
        "address": None if authority.address is None else str(authority.address),
        "not_before": authority.not_before,
        "not_after": authority.not_after,
        "sha256": fingerprint.in_hex(authority.data),
        "words": fingerprint.in_words(authority.data),
    }


def _names(authority: TlsAuthority) -> str:
    address = authority.address
    return authority.name if address is None else f"{authority.name} and {address}"


def _warning(authority: TlsAuthority, now: int) -> str:
    left = authority.not_after - now
    if left <= 0:
        return ": it has expired; rossec console tls --renew"
    return "" if left > SOON else f", in {left // DAY} days: rossec console tls --renew"
