"""What is said of a certificate that is not valid now: who does what, or that it is the clock."""

import pytest

from ca.certificates import check_time, everything_ended, own_end, span, utc, way_back
from ca.errors import CertificateExpired, CertificateNotYetValid

END = 1_800_000_000
DAY = 86_400


def test_spans_and_times_are_for_people() -> None:
    said = [span(each) for each in (1, 179, 180, 7199, 7200, 2 * DAY - 1, 400 * DAY)]
    assert said == ["1 s", "179 s", "3 min", "119 min", "2 h", "47 h", "400 days"]
    assert utc(END) == "2027-01-15 08:00:00 UTC"
    assert utc(1 << 60) == f"second {1 << 60}"


def test_a_certificate_that_is_over_says_the_clock_and_the_commands() -> None:
    back = f"where its authority is: {way_back('/robot')}"
    check_time("certificate of /robot", 0, END, END, back)
    with pytest.raises(CertificateExpired) as caught:
        check_time("certificate of /robot", 0, END, END + 400 * DAY, back)
    assert str(caught.value) == ("the certificate of /robot expired 400 days ago, on 2027-01-15 08:00:00 UTC")
    assert caught.value.hint == (
        "this host's clock says 2028-02-19 08:00:00 UTC: if that is wrong, set this host's clock,"
        " or synchronize it (NTP); else where its authority is: rossec ca renew --expired /robot,"
        " then on its machine: rossec node install FILE"
    )


def test_one_that_is_not_valid_yet_is_a_matter_of_clocks() -> None:
    with pytest.raises(CertificateNotYetValid, match="becomes valid in 400 days") as caught:
        check_time("certificate of /robot", END + 400 * DAY, END + 500 * DAY, END, "")
    assert caught.value.hint == "check this computer's clock: it says 2027-01-15 08:00:00 UTC"


@pytest.mark.parametrize("seen", [END - DAY, END, END + DAY])
def test_the_own_identity_ended(seen: int) -> None:
    error = own_end("/robot", END, END + 30, seen)
    assert str(error) == "the identity of /robot ended on 2027-01-15 08:00:00 UTC"
    assert error.hint.startswith("where the authority is: rossec ca renew --expired /robot, then")


def test_the_clock_is_in_doubt_where_nothing_else_is_so_late() -> None:
    error = own_end("/robot", END, END + 300 * DAY, END - 20 * DAY)
    assert "by this host's clock, which says 2027-11-11 08:00:00 UTC, the identity" in str(error)
    assert str(error).endswith("nothing here is newer than 2026-12-26 08:00:00 UTC")
    assert error.hint.startswith("is the clock right? if not, set this host's clock")
    assert "rossec ca renew --expired /robot" in error.hint


def test_the_authority_lasts_ten_years() -> None:
    error = everything_ended("home", END, END + 4 * 365 * DAY)
    assert "everything of 'home' is over, the authority's own certificate too" in str(error)
    assert "renew" not in error.hint


def test_the_own_node_of_the_authority_is_renewed_in_place() -> None:
    assert way_back("/ca") == "rossec ca renew /ca"
