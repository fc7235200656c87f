"""Who sees what, from grants and the graph."""

from grants.model import Restriction
from rossec.console.matrix import Cell, Heard, TopicAccess, build, held_grants, publishers_of
from tests.support.consolehome import COARSE, HOUR, NOW, POSE, FakeHome, demo, sees, sends


def cell(home: FakeHome, receiver: str, topic: str) -> Cell:
    row = home.matrix.row(topic)
    assert row is not None
    return next(each for each in row.cells if each.receiver == receiver)


def test_the_demo_has_all_four_states() -> None:
    home = demo()
    assert home.matrix.receivers == ("/doctor", "/heating")
    assert [row.topic for row in home.matrix.rows] == ["/robot/camera", "/robot/pose", "/robot/scan"]
    assert all(row.publishers == ("/robot",) for row in home.matrix.rows)
    whole = cell(home, "/doctor", "/robot/pose")
    assert (whole.access, whole.label, whole.term) == (TopicAccess.ALL, "all of it", "23 hours left")
    coarse = cell(home, "/heating", "/robot/pose")
    assert (coarse.access, coarse.label) == (TopicAccess.COARSE, "coarse")
    assert coarse.words == "position to 2 m, without direction, without the map's name"
    ended = cell(home, "/doctor", "/robot/camera")
    assert (ended.access, ended.words) == (TopicAccess.ENDED, "the visit is over")
    assert ended.term == "ended 30 minutes ago"
    nothing = cell(home, "/heating", "/robot/scan")
    assert (nothing.access, nothing.grants) == (TopicAccess.NOTHING, ())


def test_a_wide_grant_beside_a_narrow_one_shows_all() -> None:
    home = demo()
    home.grant("/heating", sees("/robot/pose"))
    found = cell(home, "/heating", "/robot/pose")
    assert found.access is TopicAccess.ALL
    assert len(found.grants) == 2
    assert found.restrictions == ()


def test_restrictions_of_one_grant_apply_together() -> None:
    home = demo()
    home.grant("/eye", sees("/robot/pose"), sees("/robot/*", Restriction(rate=1)))
    home.node("/eye")
    found = cell(home, "/eye", "/robot/pose")
    assert (found.access, found.label) == (TopicAccess.COARSE, "at times")
    assert found.words == "at most 1 a second"


def test_two_narrow_grants_are_alternatives() -> None:
    home = demo()
    home.grant("/heating", sees("/robot/pose", Restriction(rate=1)))
    assert " or " in cell(home, "/heating", "/robot/pose").words
    assert cell(home, "/heating", "/robot/pose").label == "at times"  # the widest


def test_a_grant_that_is_renewed_is_in_force_until_its_cap() -> None:
    home = demo()
    home.grant("/heating", sees("/late"), at=NOW - 2 * HOUR, last=HOUR, cap=NOW + HOUR)
    found = cell(home, "/heating", "/late")
    assert (found.access, found.term) == (TopicAccess.ALL, "renewed by itself, 1 hour left")


def test_what_ended_by_itself_or_with_its_node_is_ended() -> None:
    home = demo()
    home.grant("/heating", sees("/over"), at=NOW - 2 * HOUR, last=HOUR)
    assert cell(home, "/heating", "/over").words == "its time was over"
    home.node("/thief", revoked_at=NOW - 60, reason="stolen")
    home.grant("/thief", sees("/robot/pose"))
    assert cell(home, "/thief", "/robot/pose").words == "stolen"
    home.grant("/rekeyed", sees("/robot/pose"))
    assert cell(home, "/rekeyed", "/robot/pose").access is TopicAccess.ENDED


def test_a_grant_of_tomorrow_is_shown_now() -> None:
    home = demo()
    home.grant("/heating", sees("/soon"), at=NOW + 2 * HOUR)
    found = cell(home, "/heating", "/soon")
    assert (found.access, found.term) == (TopicAccess.ALL, "begins in 2 hours")


def test_a_pattern_has_a_row_and_covers_topics() -> None:
    home = demo()
    home.node("/recorder")
    home.grant("/recorder", sees("/robot/**"))
    assert cell(home, "/recorder", "/robot/scan").access is TopicAccess.ALL
    row = home.matrix.row("/robot/**")
    assert row is not None
    assert row.is_pattern
    assert row.publishers == ()
    assert cell(home, "/doctor", "/robot/**").access is TopicAccess.NOTHING
    assert home.matrix.rows[-1] == row


def test_names_of_anonymous_nodes_have_a_row_for_who_sees_them() -> None:
    home = demo()
    home.node("/rviz")
    home.node("/doctor2")
    home.grant("/rviz", sees("/rviz~/goal"), sends("/rviz~/marker"))
    home.grant("/doctor2", sees("/**"))
    row = home.matrix.row("/rviz~/goal")
    assert row is not None
    assert row.is_pattern
    assert home.matrix.row("/rviz~/marker") is None
    assert cell(home, "/rviz", "/rviz~/goal").access is TopicAccess.ALL
    assert cell(home, "/doctor2", "/rviz~/goal").access is TopicAccess.ALL
    assert cell(home, "/heating", "/rviz~/goal").access is TopicAccess.NOTHING
    assert publishers_of("/rviz~/marker", home.held, home.facts) == ("/rviz",)


def test_the_type_is_that_of_the_graph_or_of_a_grant() -> None:
    home = demo()
    row = home.matrix.row("/robot/scan")
    assert row is not None
    assert row.type == "sensor_msgs/LaserScan"
    without = build(home.held, (), NOW).row("/robot/pose")
    assert without is not None
    assert without.type == POSE


def test_publishers_are_those_of_the_graph_and_of_grants_in_force() -> None:
    home = demo()
    home.grant("/spare", sends("/robot/pose"))
    home.node("/spare")
    home.grant("/old", sends("/robot/pose"), revoked_at=NOW - 5)
    home.publisher("/robot/pose", "/twin", POSE)
    found = publishers_of("/robot/pose", home.held, home.facts)
    assert found == ("/robot", "/spare", "/twin")


def test_a_node_that_sends_a_topic_and_sees_another_is_marked() -> None:
    home = demo()
    home.grant("/robot", sees("/map"))
    assert cell(home, "/robot", "/robot/pose").sends
    assert not cell(home, "/robot", "/map").sends


def test_a_window_is_a_part_and_the_busiest_come_first() -> None:
    home = demo()
    home.grant("/heating", sees("/a_topic"), revoked_at=NOW - 9)
    busy = home.matrix.busiest_first()
    assert busy.receivers[0] == "/doctor"
    assert [row.topic for row in busy.rows] == ["/robot/pose", "/robot/scan", "/a_topic", "/robot/camera"]
    assert [each.receiver for each in busy.rows[0].cells] == list(busy.receivers)
    part = busy.window(slice(0, 1), slice(1, 2))
    assert part.receivers == ("/heating",)
    assert [[each.receiver for each in row.cells] for row in part.rows] == [["/heating"]]
    assert len(busy.rows[0].seen_by()) == 2


def test_what_was_ended_is_ending_until_every_node_has_heard() -> None:
    home = demo()
    home.heard = Heard(NOW - 1800)  # in the second in which it was ended: that may be before it
    found = cell(home, "/doctor", "/robot/camera")
    assert (found.access, found.label, found.words) == (TopicAccess.ENDING, "ending", "the visit is over")
    assert "until every node has heard" in found.term
    row = home.matrix.row("/robot/camera")
    assert row is not None
    assert [each.receiver for each in row.seen_by()] == ["/doctor"]
    home.heard = Heard(NOW - 1799)
    assert cell(home, "/doctor", "/robot/camera").access is TopicAccess.ENDED


def test_a_grant_whose_time_is_over_is_ended_whoever_has_heard() -> None:
    home = demo()
    home.heard = Heard()
    home.grant("/heating", sees("/over"), at=NOW - 2 * HOUR, last=HOUR, revoked_at=NOW - HOUR)
    assert cell(home, "/heating", "/over").access is TopicAccess.ENDED
    home.grant(
        "/heating", sees("/renewed"), at=NOW - 2 * HOUR, last=HOUR, cap=NOW + HOUR, revoked_at=NOW - HOUR
    )
    assert cell(home, "/heating", "/renewed").access is TopicAccess.ENDING


def test_what_stays_hides_an_ending_that_shows_no_more() -> None:
    """A cell never shows less than a node could see."""
    home = demo()
    home.heard = Heard()
    home.grant("/heating", sees("/robot/pose"), revoked_at=NOW - 9)
    assert cell(home, "/heating", "/robot/pose").access is TopicAccess.ENDING, "all of it, still"
    home.grant("/heating", sees("/robot/pose"))
    assert cell(home, "/heating", "/robot/pose").access is TopicAccess.ALL


def test_a_connection_that_outlives_a_stale_list_is_not_cut_by_time() -> None:
    keeps, cut = Restriction(keep_when_stale=True), Heard(0, NOW)
    home = demo()
    home.heard = cut
    home.grant("/heating", sees("/kept", keeps), revoked_at=NOW - 999)
    assert cell(home, "/heating", "/kept").access is TopicAccess.ENDING
    assert cell(home, "/doctor", "/robot/camera").access is TopicAccess.ENDED


def test_a_type_that_neither_graph_nor_grant_tells_is_that_of_the_policy() -> None:
    home = demo()
    row = build(home.held, (), NOW, {"/robot/scan": "sensor_msgs/LaserScan"}.get).row("/robot/scan")  # type: ignore[arg-type]
    assert row is not None
    assert row.type == "sensor_msgs/LaserScan"


def test_grants_are_newest_first() -> None:
    home = demo()
    newest = home.grant("/heating", sees("/robot/pose", COARSE), at=NOW)
    assert held_grants(home.nodes, home.grants, NOW, home.heard)[0].view == newest
