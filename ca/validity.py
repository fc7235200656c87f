"""Whether a certificate is valid at a moment, and what is said when it is not. Pure.

The moment is that of the host's clock, which may be wrong. So a certificate that is over says two
things: when the clock is right, how to have it renewed; and that it may be the clock. A certificate
that is not valid yet always is a matter of clocks, as all begin an hour early.
"""

from datetime import UTC, datetime
from typing import Final

from ca.errors import CertificateExpired, CertificateNotYetValid

SET_CLOCK: Final = "set this host's clock, or synchronize it (NTP)"
_SECONDS: Final = 180  # up to which a span is given in seconds
_DAY: Final = 86_400
_PLAUSIBLE: Final = 2 * _DAY  # that a host was off, or nothing was signed


def utc(seconds: int) -> str:
    """Seconds since the epoch as `2026-11-20 18:00:00 UTC`; the number if out of range."""
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return f"second {seconds}"


def span(seconds: int) -> str:
    """A span in one unit: `59 s`, `7 min`, `5 h`, `400 days`."""
    if seconds < _SECONDS:
        return f"{seconds} s"
    for size, unit, least in ((_DAY, "days", 2 * _DAY), (3600, "h", 7200)):
        if seconds >= least:
            return f"{seconds // size} {unit}"
    return f"{seconds // 60} min"


def way_back(name: str) -> str:
    """The commands by which the identity of `name`, which is over, comes back."""
    if name == "/ca":
        return "rossec ca renew /ca"
    return f"rossec ca renew --expired {name}, then on its machine: rossec node install FILE"


def check_time(what: str, start: int, end: int, now: int, back: str) -> None:
    """Return if a certificate, called `what`, is valid at `now`; `back`: what renews it.

    Raises:
        CertificateNotYetValid, CertificateExpired: otherwise.
    """
    if now < start:
        raise CertificateNotYetValid(
            f"the {what} becomes valid in {span(start - now)}",
            f"check this computer's clock: it says {utc(now)}",
        )
    if now > end:
        raise CertificateExpired(
            f"the {what} expired {span(now - end)} ago, on {utc(end)}",
            f"this host's clock says {utc(now)}: if that is wrong, {SET_CLOCK}; else {back}",
        )


def own_end(name: str, end: int, now: int, seen: int) -> CertificateExpired:
    """The refusal of this host's own identity `name`, which was valid until `end`.

    `seen` is the latest time that is known by anything else than the clock, such as the time of
    the newest signature here. If it is after the end, or not long ago, the clock is not in doubt.
    """
    back = f"where the authority is: {way_back(name)}"
    if seen >= end or now - seen <= _PLAUSIBLE:
        return CertificateExpired(f"the identity of {name} ended on {utc(end)}", back)
    return CertificateExpired(
        f"by this host's clock, which says {utc(now)}, the identity of {name} ended on {utc(end)};"
        f" nothing here is newer than {utc(seen)}",
        f"is the clock right? if not, {SET_CLOCK}; if it is, {back}",
    )


def everything_ended(domain: str, end: int, now: int) -> CertificateExpired:
    """The refusal where the certificate of the authority itself is over: it lasts ten years."""
    return CertificateExpired(
        f"by this host's clock, which says {utc(now)}, everything of {domain!r} is over, the"
        f" authority's own certificate too, since {utc(end)}",
        f"the clock is wrong, or the authority is ten years old: {SET_CLOCK}",
    )
