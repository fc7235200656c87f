"""Print three messages of /chatter."""

import rospy
from std_msgs.msg import String

import rossec

rossec.secure()

rospy.init_node("viewer")
for _ in range(3):
    print(rospy.wait_for_message("chatter", String, timeout=20).data)
