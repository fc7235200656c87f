"""Message types of ROS Noetic that `rosbags` leaves out: transforms and sound. Data, nothing else.

They are those of the vocabulary (`grants.vocabulary.types`), so a policy can name every type of
which it is known what it tells, also on a host without ROS.
"""

from collections.abc import Mapping
from typing import Final

_TRANSFORMS: Final = "geometry_msgs/TransformStamped[] transforms\n"

FURTHER_TYPES: Final[Mapping[str, str]] = {
    "tf2_msgs/TFMessage": _TRANSFORMS,
    "tf/tfMessage": _TRANSFORMS,
    "tf2_msgs/TF2Error": (
        "uint8 NO_ERROR = 0\nuint8 LOOKUP_ERROR = 1\nuint8 CONNECTIVITY_ERROR = 2\n"
        "uint8 EXTRAPOLATION_ERROR = 3\nuint8 INVALID_ARGUMENT_ERROR = 4\n"
        "uint8 TIMEOUT_ERROR = 5\nuint8 TRANSFORM_ERROR = 6\n\nuint8 error\nstring error_string\n"
    ),
    "audio_common_msgs/AudioData": "uint8[] data\n",
    "audio_common_msgs/AudioDataStamped": (
        "std_msgs/Header header\naudio_common_msgs/AudioData audio\n"
    ),
    "audio_common_msgs/AudioInfo": (
        "uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 bitrate\n"
        "string coding_format\n"
    ),
}
"""The text of the .msg file, by name; a type comes after those it uses."""
