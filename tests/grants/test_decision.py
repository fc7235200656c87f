"""Decisions: coverage, refusals by name, and how restrictions combine."""

from itertools import permutations

import pytest

from ca.errors import NameRefused, Revoked
from grants.decision import Decision, RevocationCheck, authorize, near_misses
from grants.errors import GrantError, GrantExpired, GrantMissing, GrantNotHeld, GrantNotYetValid, GrantRevoked
from grants.model import Grant, Permission, Restriction, Right, filter_rules, format_time
from tests.grants.authority import COARSE, HOLDER, NOW, granted

POSE, SUBSCRIBE, PUBLISH = "/robot/pose", Right.SUBSCRIBE, Right.PUBLISH
DAY = Restriction(conditions=("now.getHours() >= 8",))


def accept(grant_id: bytes, now: int) -> None:
    assert (len(grant_id), now) == (16, NOW)


def revoked(*grants: Grant) -> RevocationCheck:
    def check(grant_id: bytes, now: int) -> None:
        if grant_id in [grant.id for grant in grants]:
            raise Revoked("on the list", "ask for a new grant")

    return check


def decide(
    *grants: Grant, right: Right = SUBSCRIBE, name: str = POSE, check: RevocationCheck = accept
) -> Decision:
    return authorize(grants, right, name, holder=HOLDER, now=NOW, check=check)


def test_a_covering_grant_authorizes() -> None:
    grant = granted()
    decision = decide(grant)
    assert decision.grant_ids == (grant.id,)
    assert decision.expires == grant.expires
    assert decision.restrictions == (COARSE,)
    assert decision.explain() == [
        f"subscribe /robot/pose until {format_time(grant.expires)}",
        f"grant {grant.short_id} to /heating",
        'only when msg.header.frame_id == "map"',
        "header.frame_id: clear",
        "pose.position: round step 0.5",
    ]
    with pytest.raises(GrantError, match="granted with restrictions"):
        decision.require_unrestricted()


def test_a_grant_without_restrictions() -> None:
    decision = decide(granted(), right=PUBLISH, name="/heating/state/x")
    decision.require_unrestricted()
    assert decision.explain()[-1] == "no restrictions"


def test_no_grant_presented() -> None:
    with pytest.raises(GrantMissing, match="no grant for subscribe on /robot/pose") as refused:
        decide()
    assert refused.value.near_misses == ()
    assert refused.value.hint == "ask the authority for a grant"


def test_near_misses_are_listed() -> None:
    grant = granted(Permission("/scan", SUBSCRIBE), Permission("/pose", Right.CALL | PUBLISH))
    with pytest.raises(GrantMissing) as refused:
        decide(grant, right=PUBLISH, name="/scan")
    short = grant.short_id
    assert refused.value.near_misses == (
        f"grant {short} gives subscribe, not publish, on /scan",
        f"grant {short} is for /pose, not /scan",
    )
    assert refused.value.hint == "; ".join(refused.value.near_misses)
    with pytest.raises(GrantMissing) as refused:
        decide(granted(*[Permission(f"/n{n}", SUBSCRIBE) for n in range(9)]))
    assert len(refused.value.near_misses) == 5


@pytest.mark.parametrize("right", [Right(0), Right.PUBLISH | Right.SUBSCRIBE])
def test_exactly_one_right_is_authorized(right: Right) -> None:
    with pytest.raises(GrantMissing, match="is not one right"):
        decide(granted(Permission("/**", Right(15))), right=right)


@pytest.mark.parametrize("right", list(Right))
def test_no_right_implies_another(right: Right) -> None:
    for other in Right:
        grant = granted(Permission("/**", other))
        if other is right:
            decide(grant, right=right)
        else:
            with pytest.raises(GrantMissing):
                decide(grant, right=right)


@pytest.mark.parametrize("name", ["", "/", "pose", "~pose", "/robot/pose/", "/*"])
def test_names_must_be_absolute(name: str) -> None:
    with pytest.raises(NameRefused):
        decide(granted(Permission("/**", SUBSCRIBE)), name=name)


def test_prefixes_are_not_covered() -> None:
    for name in ("/robot/pose2", "/robot", "/robot/pose/x"):
        with pytest.raises(GrantMissing):
            decide(granted(), name=name)


def test_parameters_are_trees() -> None:
    grant = granted(Permission("/safety/max_speed", Right.PARAM_SET))
    for name in ("/safety/max_speed", "/safety/max_speed/x"):
        decide(grant, right=Right.PARAM_SET, name=name)
    with pytest.raises(GrantMissing):
        decide(grant, right=Right.PARAM_SET, name="/safety")
    with pytest.raises(GrantMissing):
        decide(grant, right=Right.PARAM_GET, name="/safety/max_speed")


REFUSALS: list[tuple[Grant, type[GrantError], str]] = [
    (granted(holder=bytes(32)), GrantNotHeld, "bound to another key"),
    (granted(not_before=NOW + 1), GrantNotYetValid, "is not valid before"),
    (granted(not_before=1, expires=NOW), GrantExpired, "expired at"),
]


@pytest.mark.parametrize(("grant", "error", "message"), REFUSALS)
def test_unusable_grants_are_refused(grant: Grant, error: type[GrantError], message: str) -> None:
    with pytest.raises(error, match=message) as refused:
        decide(grant)
    assert refused.value.hint


def test_a_revoked_grant_is_refused() -> None:
    grant = granted()
    with pytest.raises(GrantRevoked, match=f"grant {grant.short_id}: on the list") as refused:
        decide(grant, check=revoked(grant))
    assert isinstance(refused.value.__cause__, Revoked)
    assert refused.value.hint == "ask for a new grant"


def test_an_unusable_grant_does_not_hide_a_good_one() -> None:
    good = granted(serial=b"g" * 16)
    unusable = [grant for grant, _, _ in REFUSALS]
    for order in permutations([good, *unusable]):
        assert decide(*order, check=revoked(*unusable)).grant_ids == (good.id,)


def test_the_refusal_after_most_checks_is_raised() -> None:
    grants = [grant for grant, _, _ in REFUSALS]
    for order in permutations(grants):
        with pytest.raises(GrantExpired):
            decide(*order)
    for order in permutations([*grants, last := granted()]):
        with pytest.raises(GrantRevoked):
            decide(*order, check=revoked(last))


def test_other_errors_of_the_check_are_raised() -> None:
    def broken(grant_id: bytes, now: int) -> None:
        raise RuntimeError

    with pytest.raises(RuntimeError):
        decide(granted(), check=broken)


def test_restrictions_combine_in_any_order() -> None:
    coarser = Restriction(COARSE.type, (), filter_rules({"pose.position": {"round": {"step": 2.0}}}))
    grants = [
        granted(Permission(POSE, SUBSCRIBE), expires=NOW + 50, serial=b"1" * 16),
        granted(Permission("/robot/*", SUBSCRIBE, DAY), serial=b"2" * 16),
        granted(Permission(POSE, SUBSCRIBE, coarser), Permission("/**", SUBSCRIBE, COARSE)),
        granted(Permission("/other", SUBSCRIBE, DAY), serial=b"4" * 16),
    ]
    decisions = {decide(*order) for order in permutations(grants)}
    (decision,) = decisions
    assert set(decision.restrictions) == {DAY, coarser, COARSE}
    assert decision.expires == NOW + 50
    assert len(decision.grant_ids) == 3


def test_the_largest_padding_counts() -> None:
    padded = [
        granted(Permission(POSE, SUBSCRIBE, Restriction(pad=pad)), serial=bytes([pad % 251]) * 16)
        for pad in (64, 512, 256)
    ]
    assert decide(*padded).pad == 512
    assert decide(granted()).pad == 0


def test_the_same_grant_twice_counts_once() -> None:
    assert decide(granted(), granted()) == decide(granted())


PARAMETERS = (
    Permission("/safety/max_speed", Right.PARAM_SET),
    Permission("/safety/limits/**", Right.PARAM_SET),
    Permission("/robot", Right.PARAM_GET | Right.PARAM_SET),
)


@pytest.mark.parametrize(
    ("right", "name", "allowed"),
    [
        (Right.PARAM_SET, "/safety/max_speed", True),
        (Right.PARAM_SET, "/safety/max_speed/unit", True),  # the value may be a tree
        (Right.PARAM_SET, "/safety", False),  # a tree with the key in it
        (Right.PARAM_SET, "/safety/max_speedy", False),
        (Right.PARAM_SET, "/safety/limits", False),
        (Right.PARAM_SET, "/safety/limits/arm/left", True),
        (Right.PARAM_SET, "/robot/name", True),
        (Right.PARAM_GET, "/robot/name", True),
        (Right.PARAM_GET, "/safety/max_speed", False),  # the right to set does not include get
    ],
)
def test_a_parameter_right_covers_descendants_and_no_parent(right: Right, name: str, allowed: bool) -> None:
    """Parents, prefixes and the order of the rules (faults of earlier systems)."""
    for order in permutations(PARAMETERS):
        found = [granted(permission) for permission in order]
        if allowed:
            assert decide(*found, right=right, name=name).name == name
        else:
            with pytest.raises(GrantMissing):
                decide(*found, right=right, name=name)


def test_a_connection_outlives_staleness_only_if_every_permission_says_so() -> None:
    keep = Permission("/stop", Right.SUBSCRIBE, Restriction(keep_when_stale=True))
    slow = Permission("/stop", Right.SUBSCRIBE, Restriction(rate=1, keep_when_stale=True))
    plain = Permission("/stop", Right.SUBSCRIBE)
    kept = decide(granted(keep, slow), name="/stop")
    assert (kept.keep_when_stale, kept.restrictions) == (True, (Restriction(rate=1),))
    decide(granted(keep), name="/stop").require_unrestricted()
    assert not decide(granted(keep, plain), name="/stop").keep_when_stale


def test_a_near_miss_never_says_that_a_right_is_not_itself() -> None:
    given = [Right.SUBSCRIBE, Right.PUBLISH | Right.SUBSCRIBE, Right.PUBLISH]
    grants = [granted(Permission("/a", right)) for right in given]
    lines = near_misses(grants, Right.SUBSCRIBE, "/a")
    assert lines == (f"grant {grants[2].short_id} gives publish, not subscribe, on /a",)
