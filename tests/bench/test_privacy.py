"""No change makes the attackers stronger unseen: bounds at a small size, and what stands beside.

The bounds are what the attackers got when they were written, with a little room. Whoever makes one
of these tests fail has given something away, or made an attacker better: then say so.
"""

import pytest

from bench import privacy
from bench._faces import faces
from bench._flat import NAMES, PLAN, ROOMS, room_of, walk
from bench._linkers import linked_parts
from bench._observers import observed
from bench._outdoors import driven, movements, wheels
from bench._registrations import registered
from bench._trackers import habits
from bench._views import by_preset
from bench._watchers import watched
from grants.filters.coarsening import read_plan
from grants.model import Restriction, filter_rules

SECONDS, TRAINING = 900, 7200
DAYS = (2,)


@pytest.fixture(scope="module")
def positions() -> dict[str, privacy.Scores]:
    return privacy.positions(SECONDS, TRAINING, days=DAYS)


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
        ("two-receivers", 1.9, 0.7),
        ("two-topics", 1.9, 0.7),
        ("two-frames-one-body", 1.9, 0.7),
        ("rooms", 0.9, 1.0),
    ],
)
def test_a_position_is_not_known_better(
    positions: dict[str, privacy.Scores], name: str, error: float, room: float
) -> None:
    """Not by the best of the attacker, the naive reading and the habit, on the mean of the days."""
    scores = positions[name]
    assert scores["position_rmse_m"]["best"] >= error
    assert scores["room_accuracy"]["best"] <= room


def test_what_is_left_is_the_best_of_all(positions: dict[str, privacy.Scores]) -> None:
    """A grid of 2 m alone is undone, so the attacker is no straw man."""
    assert positions["round-2m"]["position_rmse_m"]["best"] < 0.6
    for scores in positions.values():
        error, room = scores["position_rmse_m"], scores["room_accuracy"]
        assert error["best"] == min(error.values()) < error["prior"]
        assert room["best"] == max(room.values())


@pytest.mark.attack("common-moments")
@pytest.mark.parametrize("name", ["two-topics-one-body", "two-frames-one-body"])
def test_a_body_is_known_no_better_by_two_topics(positions: dict[str, privacy.Scores], name: str) -> None:
    assert positions[name] == positions["coarse-position"]


@pytest.mark.attack("common-moments")
def test_two_receivers_know_what_one_does(positions: dict[str, privacy.Scores]) -> None:
    """One of them came later; both are told the same cells, at the same moments."""
    assert positions["two-receivers"] == positions["coarse-position"]


def test_connecting_anew_tells_nothing_more(positions: dict[str, privacy.Scores]) -> None:
    assert positions["coarse-position"] == positions["coarse-position-reconnecting"]


def test_arrivals_are_not_told() -> None:
    """The attacker that a rate alone told every arrival to, and who sees that somebody is there."""
    scores = watched(by_preset("presence-only", "std_msgs/String"), 4 * 3600)
    assert scores["arrivals_told"]["attacker"] <= 0.3  # by chance a sixth
    assert scores["presence_accuracy"]["attacker"] > scores["presence_accuracy"]["prior"]
    rate = Restriction("std_msgs/String", (), filter_rules({"data": {"clear": True}}), 0.1)
    assert watched(rate, 3600)["arrivals_told"]["attacker"] == 1.0


@pytest.mark.attack("registration-moments")
def test_a_master_tells_no_arrivals() -> None:
    """To a grant without slots it tells them all, to the second."""
    scores = registered(60, 4 * 3600)
    assert scores["in_slots"]["best"] <= 0.3  # by chance a sixth
    assert scores["at_once"]["best"] == 1.0


def test_parts_are_not_linked_by_what_is_written() -> None:
    scores = linked_parts((2, 5))
    assert scores["linkage_accuracy"]["naive"] <= 0.05
    assert scores["linkage_accuracy_2_min"]["attacker"] <= 0.25
    assert scores["linkage_accuracy"]["attacker"] <= 0.5
    assert scores["linkage_accuracy_2_min"]["prior"] == 0.025


def test_faces_are_not_found_in_a_gallery() -> None:
    scores = faces(64, 8, (1, 4), count=8)
    assert scores["1_pictures"]["best"] <= 0.4
    assert scores["4_pictures"]["best"] <= 0.8  # of eight
    assert scores["1_pictures"]["prior"] == 0.125


@pytest.mark.attack("common-moments")
def test_outdoors_a_place_is_not_known_better_than_its_cell_says() -> None:
    """With a message in 30 s it was 57 m; the cell of the room has 2.2 km."""
    assert driven("room", range(2, 4), 4)["best"] >= 600


@pytest.mark.attack("common-moments")
def test_wheels_and_first_messages_tell_nothing() -> None:
    found = wheels(600)
    assert found["naive"] > found["prior"] == found["best"]
    starts = movements(2 * 3600)
    assert starts["error_s"] >= 3, "the first message of a movement came at once"


@pytest.mark.attack("deflated-length")
def test_lengths_tell_an_observer_nothing() -> None:
    found = observed((2, 3), 3600)
    assert found["as_sent"]["best"] == found["as_sent"]["prior"]
    assert found["if_deflated"]["best"] > found["if_deflated"]["prior"], "which is why not"


def test_every_preset_is_attacked() -> None:
    """By the keys that `python -m bench privacy --json` writes."""
    keys = {"position_rmse_m", "room_accuracy"}
    small = privacy.positions(60, 600, ("coarse-position", "rooms"), (2,))
    assert all(scores.keys() == keys for scores in small.values())
    assert all(
        found.keys() == {"naive", "prior", "model", "attacker", "best"}
        for scores in small.values()
        for found in scores.values()
    )
    assert habits(600).occupied.sum() == pytest.approx(1)
