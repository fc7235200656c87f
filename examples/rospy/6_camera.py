"""Publish images. What a viewer sees of them is in its grant, not in this program."""

import rospy
from sensor_msgs.msg import Image

import rossec

rossec.secure()

rospy.init_node("robot")
images = rospy.Publisher("camera/image", Image, queue_size=2)
rate = rospy.Rate(50)
while not rospy.is_shutdown():
    image = Image(height=480, width=640, encoding="mono8", step=640, data=bytes(640 * 480))
    image.header.frame_id = "bedroom"
    images.publish(image)
    rate.sleep()
