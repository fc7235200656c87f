"""No change makes the attackers stronger unseen: bounds at a small size, and what stands beside.

The bounds are what the attackers got when they were written, with a little room. Whoever makes one
of these tests fail has given something away, or made an attacker better: then say so.
"""

import pytest

from bench import privacy
from bench._flat import NAMES, PLAN, ROOMS, room_of, walk
from bench._linkers import faces, linked_parts
from bench._trackers import habits
from bench._views import by_preset
from bench._watchers import watched
from grants.filters.rooms import read_plan
from grants.model import Restriction, filter_rules

SECONDS, TRAINING = 1200, 7200


@pytest.fixture(scope="module")
def positions() -> dict[str, privacy.Scores]:
    return privacy.positions(SECONDS, TRAINING)


def test_the_flat_is_the_same_for_the_same_seed() -> None:
    path = walk(2, 60)
    assert path.shape == (600, 2)
    assert (path == walk(2, 60)).all()
    assert (walk(2, 90)[:600] == path).all()
    assert (abs(path[1:] - path[:-1]).max(axis=1) < 0.06).all(), "0.5 m/s, ten times a second"


def test_the_plan_of_the_flat_is_one_of_the_product() -> None:
    by_name = {room.name: room for room in read_plan(PLAN)}
    for number, name in enumerate(NAMES):
        x, y = by_name[name].point
        assert int(room_of(x, y)) == number
        assert ROOMS[number].at(0.5, 0.5) == pytest.approx((x, y))


@pytest.mark.parametrize(
    ("name", "error", "room"),
    [
        ("coarse-position", 1.9, 0.7),
        ("coarse-position-reconnecting", 1.9, 0.7),
        ("rooms", 0.9, 1.0),
    ],
)
def test_a_position_is_not_known_better(
    positions: dict[str, privacy.Scores], name: str, error: float, room: float
) -> None:
    scores = positions[name]
    assert scores["position_rmse_m"]["attacker"] >= error
    assert scores["room_accuracy"]["attacker"] <= room


def test_the_attacker_is_no_straw_man(positions: dict[str, privacy.Scores]) -> None:
    """A grid of 2 m alone is undone, and what is known without messages is worse than with them."""
    assert positions["round-2m"]["position_rmse_m"]["attacker"] < 0.6
    for scores in positions.values():
        error = scores["position_rmse_m"]
        assert error["attacker"] <= error["naive"]
        assert error["attacker"] < error["prior"]


def test_connecting_anew_tells_nothing_more(positions: dict[str, privacy.Scores]) -> None:
    assert positions["coarse-position"] == positions["coarse-position-reconnecting"]


def test_arrivals_are_not_told() -> None:
    """The attacker that a rate alone told every arrival to, and who sees that somebody is there."""
    scores = watched(by_preset("presence-only", "std_msgs/String"), 4 * 3600)
    assert scores["arrivals_told"]["attacker"] <= 0.3  # by chance a sixth
    assert scores["presence_accuracy"]["attacker"] > scores["presence_accuracy"]["prior"]
    rate = Restriction("std_msgs/String", (), filter_rules({"data": {"clear": True}}), 0.1)
    assert watched(rate, 3600)["arrivals_told"]["attacker"] == 1.0


def test_parts_are_not_linked_by_what_is_written() -> None:
    scores = linked_parts((2, 5))
    assert scores["linkage_accuracy"]["naive"] <= 0.07
    assert scores["linkage_accuracy_2_min"]["attacker"] <= 0.2
    assert scores["linkage_accuracy"]["attacker"] <= 0.5
    assert scores["linkage_accuracy_2_min"]["prior"] == 0.062


def test_faces_are_not_found_in_a_gallery() -> None:
    scores = faces(20, 12)
    assert scores["linkage_accuracy"]["attacker"] <= 0.2
    assert scores["linkage_accuracy_10_pictures"]["attacker"] <= 0.7  # of twenty


def test_every_preset_is_attacked() -> None:
    """By the keys that `python -m bench privacy --json` writes."""
    keys = {"position_rmse_m", "room_accuracy"}
    small = privacy.positions(60, 600, ("coarse-position", "rooms"))
    assert all(scores.keys() == keys for scores in small.values())
    assert all(
        found.keys() == {"naive", "prior", "attacker"}
        for scores in small.values()
        for found in scores.values()
    )
    assert habits(600).occupied.sum() == pytest.approx(1)
