import pytest

from ca.certificates import Identity, TrustAnchor
from ca.encoding import Value
from rossec.channel.edhoc.credentials import Credentials
from rossec.discovery.announcement import MAX_SIZE, PROFILE, Announcement, read_claim, sign
from rossec.errors import AnnouncementRefused
from tests.rossec.discovery.conftest import NOW, Make
from tests.support.site import Site

NONE_REVOKED: frozenset[bytes] = frozenset()
GOOD: dict[int | str, Value] = {
    6: NOW,
    -70005: 15,
    -70011: "192.0.2.7",
    -70012: 11311,
    -70013: b"instance",
    -70014: 0,
    -70015: 0,
}


def open_announcement(
    data: bytes, anchor: TrustAnchor, revoked: frozenset[bytes], now: int
) -> tuple[Announcement, Identity]:
    claim = read_claim(data, now)
    identity = claim.verify_chain(anchor, revoked, now)
    return claim.verify(identity), identity


def test_what_is_signed_is_read(make: Make, site: Site) -> None:
    data = make(7, host="robot.local")
    assert len(data) <= MAX_SIZE
    announcement, identity = open_announcement(data, site.anchor, NONE_REVOKED, NOW)
    assert announcement == Announcement("robot.local", 11311, b"instance", 7, NOW)
    assert identity.name == "/master"


def test_only_the_master_of_this_domain_counts(site: Site, elsewhere: Site, make: Make) -> None:
    robot = site.enroll("/robot").credentials()
    data = sign(robot.signer, robot.chain, Announcement("h", 1, b"instance", 0, NOW))
    with pytest.raises(AnnouncementRefused, match=r"^/robot announces itself as a master$"):
        open_announcement(data, site.anchor, NONE_REVOKED, NOW)
    with pytest.raises(AnnouncementRefused, match="not signed by the authority"):
        open_announcement(make(), elsewhere.anchor, NONE_REVOKED, NOW)


def test_a_copied_certificate_does_not_verify(site: Site, credentials: Credentials) -> None:
    thief = site.enroll("/robot").credentials()
    data = sign(thief.signer, credentials.chain, Announcement("h", 1, b"instance", 0, NOW))
    with pytest.raises(AnnouncementRefused, match="does not verify"):
        open_announcement(data, site.anchor, NONE_REVOKED, NOW)


def test_a_revoked_master_is_refused(make: Make, site: Site) -> None:
    revoked = frozenset({site.identity("/master").thumbprint})
    with pytest.raises(AnnouncementRefused, match="revoked"):
        open_announcement(make(), site.anchor, revoked, NOW)


@pytest.mark.parametrize("later", [-6, 16])
def test_announcements_of_another_time(make: Make, site: Site, later: int) -> None:
    with pytest.raises(AnnouncementRefused, match="another time"):
        open_announcement(make(), site.anchor, NONE_REVOKED, NOW + later)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (6, -1),
        (6, True),
        (-70005, 0),
        (-70005, 16),
        (-70012, 0),
        (-70012, 65536),
        (-70014, -1),
        (-70013, b"short"),
        (-70011, ""),
        (-70011, "a b"),
        (-70011, "a/b"),
        (-70011, "a\x1bb"),
        (-70011, "x" * 256),
        (-70011, 5),
        (33, []),
        (33, ["text"]),
        (33, [b"a"] * 3),
        (33, b"a"),
        (99, 1),
        (6, None),
        (-70015, "1"),
        (-70015, -1),
        (-70015, 1 << 31),
        (-70015, True),
    ],
)
def test_fields_that_cannot_be(site: Site, credentials: Credentials, key: int, value: Value) -> None:
    payload: dict[int | str, Value] = {**GOOD, 33: [credentials.certificate], key: value}
    if value is None:
        del payload[key]
    data = PROFILE.sign(credentials.signer, payload)
    with pytest.raises(AnnouncementRefused):
        open_announcement(data, site.anchor, NONE_REVOKED, NOW)


def test_one_datagram_is_the_limit(make: Make, site: Site, credentials: Credentials) -> None:
    with pytest.raises(AnnouncementRefused, match="does not fit a datagram"):
        sign(credentials.signer, credentials.chain * 3, Announcement("x" * 255, 1, b"instance", 0, NOW))
    with pytest.raises(AnnouncementRefused):
        open_announcement(make() + bytes(MAX_SIZE), site.anchor, NONE_REVOKED, NOW)


def test_every_flipped_bit_and_every_cut_is_refused(make: Make, site: Site) -> None:
    data = make()
    for place in range(0, len(data) * 8, 3):
        flipped = bytearray(data)
        flipped[place // 8] ^= 1 << place % 8
        with pytest.raises(AnnouncementRefused):
            open_announcement(bytes(flipped), site.anchor, NONE_REVOKED, NOW)
    for length in range(0, len(data), 7):
        with pytest.raises(AnnouncementRefused):
            open_announcement(data[:length], site.anchor, NONE_REVOKED, NOW)
