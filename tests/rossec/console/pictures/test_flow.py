"""The flow in three columns."""

import math

from rossec.console.matrix import Matrix, TopicAccess
from rossec.console.pictures import flow
from rossec.console.pictures.svg import Point, along
from tests.support.consolehome import crowd, demo, sees
from tests.support.drawings import checked, classes, texts


def test_every_state_has_a_line_of_its_own() -> None:
    root = checked(flow.draw(demo().matrix, {"/heating": ["/robot/scan"]}))
    found = classes(root)
    assert found.count("flow-all") == 2
    assert found.count("flow-coarse") == 1
    assert found.count("flow-ended") == 2  # one ended, one refused
    assert found.count("badge") == 2
    assert found.count("sent") == 3
    assert {"/robot", "/robot/pose", "/doctor", "/robot/scan"} <= set(texts(root))


def test_who_was_refused_everything_has_a_box() -> None:
    root = checked(flow.draw(demo().matrix, {"/stranger": ["/a", "/b"]}))
    assert "/stranger" in texts(root)
    assert "2 refused" in texts(root)


def test_a_crowd_is_bounded() -> None:
    home = crowd()
    refused = {f"/receiver_{at:02}": [f"/{at}"] for at in range(29)}
    drawn = flow.draw(home.matrix, refused)
    root = checked(drawn)
    assert classes(root).count("box") <= flow.MAX_ROWS
    assert classes(root).count("box end") <= 2 * flow.MAX_ROWS
    assert len(str(drawn)) < 30_000


def lines_of(matrix: Matrix) -> tuple[list[flow.Line], list[flow.Line]]:
    """Struck lines and others, between boxes one below the other."""
    struck, others = [], []
    for top, row in enumerate(matrix.rows):
        for low, cell in enumerate(row.cells):
            line = ((385.0, 54.0 * top), (455.0, 54.0 * low))
            if cell.access is TopicAccess.ENDED:
                struck.append(line)
            elif cell.access is not TopicAccess.NOTHING:
                others.append(line)
    return struck, others


def distance(point: Point, line: flow.Line) -> float:
    return min(math.dist(point, along(*line, at / 200)) for at in range(201))


def test_the_mark_of_what_ended_lies_on_no_line_that_goes() -> None:
    """In the demo the middle of camera to doctor was exactly that of scan to heating."""
    crossing = (((385.0, 0.0), (455.0, 108.0)), ((385.0, 108.0), (455.0, 0.0)))
    struck, going = crossing
    middle = along(*struck, 0.5)
    assert distance(middle, going) < 1
    (place,) = flow.free_places([struck], [going])
    assert distance(place, struck) < 1
    assert distance(place, going) > 9, "the radius of the mark"
    home = demo()
    home.node("/visitor")
    home.grant("/heating", sees("/robot/scan"))
    home.grant("/visitor", sees("/robot/pose"))
    struck_lines, others = lines_of(home.matrix)
    assert struck_lines
    for found in flow.free_places(struck_lines, others):
        assert min(distance(found, each) for each in others) > 9


def test_marks_do_not_cover_each_other_and_an_alone_one_is_in_the_middle() -> None:
    one, two = ((0.0, 0.0), (70.0, 100.0)), ((0.0, 100.0), (70.0, 0.0))
    assert flow.free_places([one], []) == [along(*one, 0.5)]
    first, second = flow.free_places([one, two], [])
    assert math.dist(first, second) > 18


def test_a_title_has_the_name_below_it() -> None:
    titles = {"/doctor": "Dr. Meier", "/robot/pose": "where the robot is at this moment"}
    root = checked(flow.draw(demo().matrix, None, lambda name: titles.get(name, "")))
    assert {"Dr. Meier", "/doctor", "where the robot is a…", "/robot/pose"} <= set(texts(root))


def test_where_nothing_flows_there_is_no_picture() -> None:
    assert flow.draw(Matrix((), ())) is None
    assert flow.draw(Matrix((), ()), {"/a": []}) is None
