"""Provide the service /lamp."""

import rospy
from std_srvs.srv import SetBool, SetBoolResponse

import rossec

rossec.secure()


def switch(request: SetBool) -> SetBoolResponse:
    return SetBoolResponse(True, "on" if request.data else "off")


rospy.init_node("robot")
rospy.Service("lamp", SetBool, switch)
rospy.spin()
