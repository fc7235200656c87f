"""Use parameters: its own, and one it has no right to."""

import rospy

import rossec

rossec.secure()

rospy.init_node("viewer")
rospy.set_param("~speed", 0.5)
print("speed", rospy.get_param("~speed"))
print("secret", rospy.get_param("/other/secret", "not for us"))
