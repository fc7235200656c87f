"""The imports of the sidecar process; running it is tested with `rossec run`."""

import subprocess
import sys

PRINT_IMPORTS = """
import sys
import rossec.sidecar.__main__
heavy = {"rospy", "rosgraph", "roslib", "genpy", "std_msgs", "numpy", "rosbags", "click"}
print(sorted(heavy & {name.partition(".")[0] for name in sys.modules}))
"""


def test_the_sidecar_process_imports_no_ros_packages() -> None:
    """So it runs beside a ROS whose Python is too old for rossec, and stays small."""
    command = [sys.executable, "-I", "-c", PRINT_IMPORTS]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"
