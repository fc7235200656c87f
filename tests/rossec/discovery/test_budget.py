import pytest

from rossec.discovery.announcement import MAX_SOURCES, MAX_VERIFIED, Budget
from rossec.errors import AnnouncementRefused


def spend(budget: Budget, source: str, times: int, clock: float = 1.0, *, known: bool = False) -> int:
    """How often it was possible."""
    for count in range(times):
        try:
            budget.spend(source, 1, clock, known_chain=known)
        except AnnouncementRefused:
            return count
    return times


def test_an_address_has_a_share_and_all_have_a_total() -> None:
    budget = Budget(share=5, total=12)
    assert [spend(budget, name, 9) for name in "abcd"] == [5, 5, 2, 0]
    assert spend(budget, "d", 9, known=True) == 5
    assert spend(budget, "a", 9, clock=2.0) == 5


def test_a_verified_source_is_limited_by_its_own_bucket_alone() -> None:
    budget = Budget(share=5, total=12)
    assert spend(budget, "good", 1) == 1
    budget.note_verified("good")
    budget.note_verified("good")
    assert [spend(budget, name, 9) for name in "abc"] == [5, 5, 1]
    assert spend(budget, "good", 9) == 4


def test_sources_are_bounded() -> None:
    budget = Budget(share=5, total=10_000)
    for number in range(MAX_SOURCES + 9):
        spend(budget, f"s{number}", 1)
    assert len(budget._shares) == MAX_SOURCES
    for number in range(MAX_VERIFIED + 9):
        budget.note_verified(f"s{number}")
    assert len(budget._verified) == MAX_VERIFIED


def test_the_refusal_has_a_message() -> None:
    with pytest.raises(AnnouncementRefused, match="more announcements than can be checked"):
        Budget(share=0).spend("a", 1, 1.0, known_chain=True)
