"""When a grant is valid: `not_before <= now < expires`, by the host's clock, never ROS time."""

from datetime import UTC, datetime

from grants.errors import GrantExpired, GrantNotYetValid
from grants.model import Grant


def check_time(grant: Grant, now: int) -> None:
    """Return if `grant` is valid at `now` (seconds since the epoch).

    Raises:
        GrantNotYetValid, GrantExpired: otherwise.
    """
    if now < grant.not_before:
        raise GrantNotYetValid(
            f"grant {grant.short_id} is not valid before {format_time(grant.not_before)}",
            "check this host's clock",
        )
    if now >= grant.expires:
        raise GrantExpired(
            f"grant {grant.short_id} expired at {format_time(grant.expires)}",
            "ask the authority to renew it, or check this host's clock",
        )


def format_time(seconds: int) -> str:
    """Seconds since the epoch as `2026-11-20 18:00:00 UTC`; the number if out of range."""
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return f"second {seconds}"
