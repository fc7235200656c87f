"""Pictures of a place: a track, squares, a map."""

from pathlib import Path

import pytest

from grants.model import Restriction, filter_rules
from rossec.console import samples
from rossec.console.pictures import place
from rossec.console.samples import SeenTopic, SyntheticSample, see
from tests.support.consolehome import COARSE, POSE
from tests.support.drawings import checked, classes, texts

FIX = "sensor_msgs/NavSatFix"
TYPES = sorted(
    [
        POSE,
        FIX,
        "geometry_msgs/Pose",
        "geometry_msgs/PointStamped",
        "nav_msgs/Odometry",
        "geometry_msgs/TransformStamped",
        "geometry_msgs/PoseWithCovarianceStamped",
    ]
)


def seen(kind: str = POSE, *restrictions: Restriction) -> SeenTopic:
    recorded = samples.recorded("/robot/pose", kind)
    assert recorded is not None
    return see(recorded, "/doctor", restrictions)


def poses(*points: tuple[float, float]) -> SeenTopic:
    samples = tuple(
        SyntheticSample(at, {"pose": {"position": {"x": x, "y": y}}}) for at, (x, y) in enumerate(points)
    )
    return SeenTopic("/doctor", "/pose", POSE, len(samples), samples)


@pytest.mark.parametrize("kind", TYPES)
def test_every_type_with_a_place_has_a_track(kind: str) -> None:
    assert place.has_place(kind)
    whole = seen(kind)
    frame = place.frame_of([whole])
    assert frame is not None
    root = checked(place.draw(whole, frame, None))
    assert [each for each in classes(root) if each.startswith("track")] == [
        f"track shade{number}" for number in range(1, 6)
    ]
    assert place.places(whole) > 200


def test_cells_are_squares_and_the_last_has_a_border() -> None:
    coarse, whole = seen(POSE, COARSE), seen()
    frame = place.frame_of([whole], [COARSE])
    assert frame is not None
    assert place.cells_of([COARSE]) == [(2.0, 2.0)]
    root = checked(place.draw(coarse, frame, (2.0, 2.0)))
    squares = [each for each in classes(root) if each.startswith("square")]
    assert len(squares) == place.places(coarse) == 12
    assert sum(each.endswith("now") for each in squares) == 1
    assert "heading" not in classes(root)


def test_the_direction_is_drawn_only_where_it_is_known() -> None:
    whole = seen()
    without = Restriction(POSE, (), filter_rules({"pose.orientation": {"clear": True}}))
    frame = place.frame_of([whole])
    assert frame is not None
    assert "heading" in classes(checked(place.draw(whole, frame, None)))
    assert "heading" not in classes(checked(place.draw(seen(POSE, without), frame, None)))
    assert "heading" not in classes(checked(place.draw(poses((1, 2), (2, 3)), frame, None)))


def test_both_pictures_have_one_frame_and_a_ruler() -> None:
    frame = place.frame_of([seen()], [COARSE])
    assert frame is not None
    exact, coarse = place.draw(seen(), frame, None), place.draw(seen(POSE, COARSE), frame, (2, 2))
    assert "2 m" in texts(checked(exact))
    assert "2 m" in texts(checked(coarse))
    assert exact is not None
    assert coarse is not None


def test_a_removed_place_is_not_drawn() -> None:
    gone = Restriction(POSE, (), filter_rules({"pose.position": {"clear": True}}))
    frame = place.frame_of([seen()])
    assert frame is not None
    assert place.draw(seen(POSE, gone), frame, None) is None
    assert place.frame_of([seen(POSE, gone)]) is None


def test_a_place_on_earth_has_cells_in_metres() -> None:
    coarse = Restriction(FIX, (), filter_rules({"latitude": {"round": {"step": 0.001}}}))
    frame = place.frame_of([seen(FIX)], [coarse])
    assert frame is not None
    ((east, north),) = place.cells_of([coarse], frame.origin)
    assert north == pytest.approx(111.3, abs=0.1)
    assert 60 < east < north
    assert place.cells_of([coarse]) == []
    checked(place.draw(seen(FIX, coarse), frame, (east, north)))


@pytest.mark.parametrize(
    "points",
    [[(1, 1)], [(5, 5), (5, 5)], [(0, 0), (9e7, -9e7)], [(float("nan"), 1), (1, 2)], [(1e-9, 0), (2e-9, 0)]],
    ids=["one", "still", "far", "nan", "tiny"],
)
def test_strange_places_stay_in_the_frame(points: list[tuple[float, float]]) -> None:
    strange = poses(*points)
    frame = place.frame_of([strange])
    assert frame is not None
    checked(place.draw(strange, frame, None))
    checked(place.draw(strange, frame, (2.0, 2.0)))


def test_a_type_without_a_place_has_none() -> None:
    other = SeenTopic("/a", "/b", "std_msgs/Float64", 1, (SyntheticSample(0, {"data": 1.0}),))
    assert place.frame_of([other]) is None
    assert place.places(other) == 0
    assert place.cells_of([Restriction("std_msgs/Float64", (), (), 1.0)]) == []


def test_the_picture_of_the_demo_is_as_it_was() -> None:
    """To store a new one on purpose, write `str(...)` below into the file, and look at it."""
    frame = place.frame_of([seen()], [COARSE])
    assert frame is not None
    golden = Path(__file__).parent / "place.svg"
    assert f"{place.draw(seen(POSE, COARSE), frame, (2, 2))}\n" == golden.read_text()
