"""The policy of an authority on disk."""

from pathlib import Path

import pytest

from ca.errors import PathRefused
from grants.errors import PolicyRefused
from rossec.authority.policyfile import PolicyFile, layout_of, parse_policy, place, read_policy
from rossec.errors import ConfigurationError

TEXT = "rossec: 1\nrobot: r\nrules: []\n"


def test_the_path_of_the_policy(tmp_path: Path) -> None:
    assert place(tmp_path, None) == tmp_path / "ca" / "policy.yaml"
    assert place(tmp_path, tmp_path / "x") == tmp_path / "x"


def test_a_policy_is_replaced_only_by_a_valid_one(tmp_path: Path) -> None:
    path = tmp_path / "policy.yaml"
    path.write_text(TEXT)
    read = PolicyFile.read(path)
    assert (read.policy.robot, read.text) == ("r", TEXT)
    changed = read.replace(TEXT.replace("robot: r", "robot: s"))
    assert changed.decider.policy.robot == "s"
    with pytest.raises(PolicyRefused):
        read.replace("rossec: 2")
    assert PolicyFile.read(path).policy.robot == "s"


def test_an_invalid_policy_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="there is no policy") as caught:
        PolicyFile.read(tmp_path / "policy.yaml")
    assert caught.value.hint == "next: rossec policy init"
    (tmp_path / "policy.yaml").write_bytes(b"\xff")
    with pytest.raises(ConfigurationError, match="is not UTF-8"):
        PolicyFile.read(tmp_path / "policy.yaml")


def test_layouts_of_known_types() -> None:
    assert layout_of("std_msgs/String").type_name == "std_msgs/String"


def test_a_policy_names_transforms_sound_and_the_types_of_packages_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "bed_msgs" / "msg"
    own.mkdir(parents=True)
    (own / "Bed.msg").write_text("Header header\nfloat64 weight\n")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    read = parse_policy(
        "rossec: 1\nrobot: r\ntypes: {/tf: tf2_msgs/TFMessage, /mic: audio_common_msgs/AudioData,"
        " /bed: bed_msgs/Bed}\nvocabulary: {bed_msgs/Bed: {weight: identity}}\nrules:\n"
        "  - {id: a, who: /x, allow: {subscribe: [/tf, /mic, /bed]},"
        " see: {position: room, sound: no, identity: no}}\n",
        "policy.yaml",
    )
    [rule] = read.rules
    filtered = {each.pattern: each.restriction for each in rule.clauses}
    for topic, path in (("/tf", "transforms"), ("/mic", "data"), ("/bed", "weight")):
        restriction = filtered[topic]
        assert restriction is not None
        assert path in {each.path for each in restriction.filters}
    assert layout_of("bed_msgs/Bed").type_name == "bed_msgs/Bed"


def test_two_editors_at_once_lose_no_rule(tmp_path: Path) -> None:
    path = tmp_path / "policy.yaml"
    path.write_text(TEXT)
    slower, faster = PolicyFile.read(path), PolicyFile.read(path)
    faster.replace(TEXT.replace("robot: r", "robot: faster"))
    with pytest.raises(ConfigurationError, match="was changed while this command") as caught:
        slower.replace(TEXT.replace("robot: r", "robot: slower"))
    assert "run the command again" in caught.value.hint
    assert "faster" in path.read_text()
    slower.path.unlink()
    with pytest.raises(ConfigurationError, match="is gone, nothing was done"):
        slower.check_unchanged()
    assert slower.replace(TEXT).text == path.read_text()


def test_a_policy_that_others_can_write_signs_nothing(tmp_path: Path) -> None:
    (tmp_path / "ca").mkdir(mode=0o700)
    with pytest.raises(ConfigurationError):
        read_policy(tmp_path, None)
    for path in (tmp_path / "ca" / "policy.yaml", tmp_path / "other.yaml"):
        path.write_text(TEXT)
    assert read_policy(tmp_path, None).path == tmp_path / "ca" / "policy.yaml"
    path.chmod(0o666)
    assert read_policy(tmp_path, path).path == path
    with pytest.raises(PathRefused):
        read_policy(tmp_path, path, signs=True)
    (tmp_path / "ca" / "policy.yaml").chmod(0o666)
    with pytest.raises(PathRefused):
        read_policy(tmp_path, None)


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o644])
def test_a_rewritten_policy_keeps_its_mode_and_owner(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "policy.yaml"
    path.write_text(TEXT)
    path.chmod(mode)
    before = path.stat()
    PolicyFile.read(path).replace(TEXT.replace("robot: r", "robot: s"))
    after = path.stat()
    assert (after.st_mode, after.st_uid, after.st_gid) == (before.st_mode, before.st_uid, before.st_gid)
    new = tmp_path / "new.yaml"
    PolicyFile(new, TEXT, PolicyFile.read(path).policy).replace(TEXT)
    assert new.stat().st_mode & 0o777 == 0o644
