"""Where ROSSEC_HOME does not have what was asked for, what is there is said first."""

from pathlib import Path

import pytest

from rossec import environment


def made(home: Path, *names: str) -> Path:
    for name in names:
        directory = home / "nodes" / name.lstrip("/").replace("/", ".")
        directory.mkdir(parents=True)
        (directory / "node.key").touch()
    return home


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "user"))


def test_a_mistyped_name_is_answered_with_the_near_one(tmp_path: Path) -> None:
    home = made(tmp_path / "home", "/robot", "/heating", "/site/robots/r01")
    assert environment.nodes_in(home) == ["/heating", "/robot", "/site/robots/r01"]
    hint = environment.missing_node(home, "/heatin")
    assert hint == (
        "did you mean /heating? here are: /heating, /robot, /site/robots/r01;"
        " for a new node: rossec node request /heatin"
    )


def test_without_a_near_name_those_that_are_here_are_said(tmp_path: Path) -> None:
    home = made(tmp_path / "home", *(f"/r{number}" for number in range(1, 9)))
    hint = environment.missing_node(home, "/lighthouse")
    assert hint.startswith("here are: /r1, /r2, /r3, /r4, /r5, /r6 and 2 more; for a new node: ")


def test_the_name_of_an_anonymous_node(tmp_path: Path) -> None:
    hint = environment.missing_node(tmp_path, "/record_17_1732391")
    assert hint.startswith("next: rossec node request /record_17_1732391, or for all such nodes")
    assert hint.endswith("rossec node request /record --anonymous")


def test_a_home_that_was_not_named_is_said(tmp_path: Path) -> None:
    unset = tmp_path / "user" / ".local" / "share" / "rossec"
    begin = "ROSSEC_HOME is not set: if it is elsewhere, export ROSSEC_HOME=DIRECTORY; else next: "
    assert environment.missing_authority(unset) == f"{begin}rossec ca init DOMAIN"
    assert environment.missing_node(unset, "/a") == f"{begin}rossec node request /a"
    assert environment.missing_nodes(unset) == f"{begin}rossec node request /NAME"
    assert environment.missing_authority(tmp_path / "named") == "next: rossec ca init DOMAIN"


def test_a_mistyped_home_is_answered_with_the_near_one(tmp_path: Path) -> None:
    made(tmp_path / "rossec-home", "/robot")
    (tmp_path / "rossec-other").mkdir()
    hint = environment.missing_authority(tmp_path / "rossec-hom")
    assert hint == (
        f"there is no directory {tmp_path / 'rossec-hom'}: did you mean {tmp_path / 'rossec-home'}?"
        " else next: rossec ca init DOMAIN"
    )
    assert environment.missing_nodes(tmp_path / "gone" / "deep").startswith("next: ")


def test_a_home_of_nodes_alone_is_no_place_for_an_authority(tmp_path: Path) -> None:
    hint = environment.missing_authority(made(tmp_path / "home", "/robot"))
    assert hint.startswith("here are only nodes: /robot; run this where the authority is")
