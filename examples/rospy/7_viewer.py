"""Look at the camera's images: five a second, and not where the camera is."""

import rospy
from sensor_msgs.msg import Image

import rossec

rossec.secure()

rospy.init_node("viewer")
for _ in range(3):
    image = rospy.wait_for_message("camera/image", Image, timeout=20)
    print(image.width, "x", image.height, repr(image.header.frame_id))
