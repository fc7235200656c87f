"""Pictures of laser scans."""

import math

from grants.model import Restriction, filter_rules
from rossec.console import samples
from rossec.console.pictures import looks
from rossec.console.samples import SeenTopic, SyntheticSample, see
from tests.support.drawings import checked, classes, texts


def seen(*restrictions: Restriction) -> SeenTopic:
    recorded = samples.recorded("/robot/scan", looks.SCAN_TYPE)
    assert recorded is not None
    return see(recorded, "/doctor", restrictions)


def scan(*ranges: float) -> SeenTopic:
    fields = {"angle_min": 0.0, "angle_increment": 0.1, "ranges": list(ranges)}
    return SeenTopic("/doctor", "/scan", looks.SCAN_TYPE, 1, (SyntheticSample(0, fields),))


def test_every_ray_is_a_point() -> None:
    whole = seen()
    reach = looks.reach_of(whole)
    assert 5 < reach < 7
    root = checked(looks.draw_scan(whole, reach))
    assert classes(root).count("hit") == 180
    assert "6 m" in texts(root)


def test_removed_distances_leave_an_empty_circle() -> None:
    gone = seen(Restriction(looks.SCAN_TYPE, (), filter_rules({"ranges": {"drop": True}})))
    root = checked(looks.draw_scan(gone, looks.reach_of(gone)))
    assert "hit" not in classes(root)
    assert "outline" not in classes(root)
    assert looks.reach_of(gone) == 0


def test_strange_distances_are_left_out_or_stay_inside() -> None:
    strange = scan(math.nan, math.inf, -1.0, 0.0, 3.0, 50.0)
    assert looks.reach_of(strange) == 50
    assert classes(checked(looks.draw_scan(strange, 10.0))).count("hit") == 2


def test_many_rays_are_thinned_and_none_is_no_picture() -> None:
    assert classes(checked(looks.draw_scan(scan(*[1.0] * 5000), 1.0))).count("hit") <= 360
    assert looks.draw_scan(SeenTopic("/a", "/b", looks.SCAN_TYPE, 1, ()), 1.0) is None
