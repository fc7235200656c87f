"""The flow in three columns."""

from rossec.console.matrix import Matrix
from rossec.console.pictures import flow
from tests.support.consolehome import crowd, demo
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


def test_where_nothing_flows_there_is_no_picture() -> None:
    assert flow.draw(Matrix((), ())) is None
    assert flow.draw(Matrix((), ()), {"/a": []}) is None
