"""What the sidecar's own process carries; how it runs is tested with `rossec run`."""

import subprocess
import sys

CARRIED = """
import sys
import rossec.sidecar.__main__
heavy = {"rospy", "rosgraph", "roslib", "genpy", "std_msgs", "numpy", "rosbags", "click"}
print(sorted(heavy & {name.partition(".")[0] for name in sys.modules}))
"""


def test_it_needs_no_ros_in_its_own_python() -> None:
    """So it runs beside a ROS whose Python is too old for rossec; and stays small."""
    command = [sys.executable, "-I", "-c", CARRIED]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"
