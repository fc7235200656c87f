"""When a grant holds: `not_before <= now < expires`, on the host's clock, never on ROS time."""

from datetime import UTC, datetime

from grants.errors import GrantExpired, GrantNotYetValid
from grants.model import Grant


def check_time(grant: Grant, now: int) -> None:
    """Return if `grant` holds at `now` (seconds since the epoch).

    Raises:
        GrantNotYetValid, GrantExpired: otherwise.
    """
    if now < grant.not_before:
        raise GrantNotYetValid(
            f"grant {grant.short_id} holds only from {moment(grant.not_before)}",
            "check this host's clock",
        )
    if now >= grant.expires:
        raise GrantExpired(
            f"grant {grant.short_id} expired at {moment(grant.expires)}",
            "ask the authority to renew it, or check this host's clock",
        )


def moment(seconds: int) -> str:
    """Seconds since the epoch for people: `2026-11-20 18:00:00 UTC`, or the number if too far."""
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return f"second {seconds}"
