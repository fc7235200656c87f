"""Half-open validity, and times as text."""

import pytest

from grants.errors import GrantExpired, GrantNotYetValid
from grants.model import check_time, format_time
from tests.grants.authority import NOW, granted


def test_validity_is_half_open() -> None:
    grant = granted()
    check_time(grant, grant.not_before)
    check_time(grant, grant.expires - 1)
    with pytest.raises(GrantNotYetValid, match="is not valid before 2027-01-15 07:59:50 UTC"):
        check_time(grant, grant.not_before - 1)
    with pytest.raises(GrantExpired, match="expired at 2027-01-15 08:01:40 UTC"):
        check_time(grant, grant.expires)


def test_times_are_formatted_in_utc() -> None:
    assert format_time(NOW) == "2027-01-15 08:00:00 UTC"
    assert format_time(1 << 52) == f"second {1 << 52}"
