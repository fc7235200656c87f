"""Types that are not of `rosbags`: what ROS says they are, by their md5sums."""

import importlib

import pytest

from grants.vocabulary.contents import TYPES
from rossec.participant.message_types import FURTHER_TYPES, message_type, type_names

SUMS = {
    "tf2_msgs/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "tf/tfMessage": "94810edda583a504dfda3829e70d7eec",
    "tf2_msgs/TF2Error": "bc6848fd6fd750c92e38575618a4917d",
    "audio_common_msgs/AudioData": "f43a8e1b362b75baa741461b46adc7e0",
    "audio_common_msgs/AudioDataStamped": "3cdd84a06846af0dca4d0434908f9d96",
    "audio_common_msgs/AudioInfo": "9413d9b7029680d3b1db6ed0ae535f88",
}


@pytest.mark.parametrize("name", FURTHER_TYPES)
def test_a_type_has_the_md5sum_of_ros(name: str) -> None:
    assert message_type(name).md5sum == SUMS[name]


def test_every_type_of_the_vocabulary_is_known() -> None:
    assert set(type_names()) >= TYPES.keys()


@pytest.mark.ros
def test_transforms_are_those_of_debian() -> None:
    found = importlib.import_module("tf2_msgs.msg")
    for name in ("TFMessage", "TF2Error"):
        assert getattr(found, name)._md5sum == message_type(f"tf2_msgs/{name}").md5sum
