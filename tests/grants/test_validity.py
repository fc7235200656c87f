"""Half-open validity, and moments for people."""

import pytest

from grants.errors import GrantExpired, GrantNotYetValid
from grants.validity import check_time, moment
from tests.grants.authority import NOW, granted


def test_half_open() -> None:
    grant = granted()
    check_time(grant, grant.not_before)
    check_time(grant, grant.expires - 1)
    with pytest.raises(GrantNotYetValid, match="holds only from 2027-01-15 07:59:50 UTC"):
        check_time(grant, grant.not_before - 1)
    with pytest.raises(GrantExpired, match="expired at 2027-01-15 08:01:40 UTC"):
        check_time(grant, grant.expires)


def test_moments() -> None:
    assert moment(NOW) == "2027-01-15 08:00:00 UTC"
    assert moment(1 << 52) == f"second {1 << 52}"
