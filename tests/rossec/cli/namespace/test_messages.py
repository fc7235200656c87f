from pathlib import Path

from tests.support.commands import Shell, refused


def test_the_package_is_written_once(empty: Shell, tmp_path: Path) -> None:
    said = empty("namespace", "messages", str(tmp_path))
    assert (said.code, said.out) == (0, f"{tmp_path}/rossec_namespace\n")
    assert (tmp_path / "rossec_namespace" / "srv" / "GetTopicName.srv").exists()
    refused(empty("namespace", "messages", str(tmp_path)), "is not overwritten")
    assert empty("namespace", "messages", str(tmp_path / "none")).code == 2
