from pathlib import Path

from tests.rossec.namespace.launch_texts import FIGURES, launch, node, topic
from tests.support.commands import Shell, refused

FIGURE, NAMED = FIGURES / "phones.launch", FIGURES / "phones.named.launch"


def test_the_figure_of_the_thesis(empty: Shell, tmp_path: Path) -> None:
    """Figure A.4, with the print's errors repaired: `>true`, and `wandfluter` for `wallwasher`."""
    out = tmp_path / "out.launch"
    said = empty("namespace", "launch", str(FIGURE), "--out", str(out))
    assert (said.code, said.out) == (0, f"{out}\n"), said.err
    assert out.read_bytes() == NAMED.read_bytes()
    assert "topic ~output2 is /n1/raum3/lamps/wallwasher" in said.err
    before = out.read_bytes()
    refused(
        empty("namespace", "launch", str(FIGURE), "--out", str(out)), "exists and is not overwritten", "--out"
    )
    assert out.read_bytes() == before


def test_what_has_no_name_is_refused_with_its_line(empty: Shell, tmp_path: Path) -> None:
    source, out = tmp_path / "in.launch", tmp_path / "out.launch"
    source.write_bytes(launch(node(topic(), "<ns:group>a b</ns:group>")))
    said = empty("namespace", "launch", str(source), "--out", str(out))
    refused(said, "in.launch: line 2: the node 'lamp': the rules do not give a name")
    assert not out.exists()


def test_what_is_worth_a_word(empty: Shell, tmp_path: Path) -> None:
    source, out = tmp_path / "in.launch", tmp_path / "out.launch"
    source.write_bytes(launch("<include file='$(find x)/y.launch'/>"))
    said = empty("namespace", "launch", str(source), "--out", str(out))
    assert said.code == 0
    assert "$(find x)/y.launch is not followed" in said.err
    assert "has no node with metadata" in said.err
    assert out.read_bytes() == source.read_bytes()


def test_a_file_is_named(empty: Shell, tmp_path: Path) -> None:
    assert empty("namespace", "launch", str(FIGURE)).code == 2
    assert empty("namespace", "launch", str(tmp_path / "none"), "--out", "x").code == 2
