import json

import pytest

from rossec.console.tls import certificates
from rossec.console.tls.certificates import DAY, as_json, describe
from tests.support.console_tls import HOST, NAME, NOW, new_authority


def test_a_terminal_shows_the_fingerprint_in_both_forms() -> None:
    authority = new_authority()
    lines = describe(authority, NOW)
    assert lines[0] == f"TLS authority of the console, for {NAME} and {HOST} alone"
    assert ":".join(line.strip() for line in lines[3:5]) == certificates.in_hex(authority.data)
    assert lines[-1].strip() == certificates.in_words(authority.data)
    assert max(map(len, lines)) <= 80


def test_an_authority_without_an_address_is_for_its_name() -> None:
    assert describe(new_authority(address=None), NOW)[0].endswith(f"for {NAME} alone")


@pytest.mark.parametrize(
    ("days", "said"), [(300, ""), (340, "in 25 days: rossec console tls"), (366, "has expired")]
)
def test_a_person_is_told_before_it_ends(days: int, said: str) -> None:
    line = describe(new_authority(), NOW + days * DAY)[1]
    assert said in line
    assert ("--renew" in line) == bool(said)


def test_programs_get_the_same() -> None:
    authority = new_authority()
    found = json.loads(json.dumps(as_json(authority)))
    assert found["sha256"] == certificates.in_hex(authority.data)
    assert (found["name"], found["address"]) == (NAME, str(HOST))
    assert as_json(new_authority(address=None))["address"] is None
