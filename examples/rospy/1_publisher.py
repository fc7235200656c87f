"""Publish on /chatter. The two lines with `rossec` are all that is new."""

import rospy
from std_msgs.msg import String

import rossec

rossec.secure()

rospy.init_node("robot")
chatter = rospy.Publisher("chatter", String, queue_size=10)
rate = rospy.Rate(10)
count = 0
while not rospy.is_shutdown():
    chatter.publish(f"hello {count}")
    count += 1
    rate.sleep()
