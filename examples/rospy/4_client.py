"""Call the service /lamp."""

import rospy
from std_srvs.srv import SetBool

import rossec

rossec.secure()

rospy.init_node("viewer")
rospy.wait_for_service("lamp", timeout=20)
lamp = rospy.ServiceProxy("lamp", SetBool)
print(lamp(True).message, lamp(False).message)
