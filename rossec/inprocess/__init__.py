"""`import rossec; rossec.secure()`: the connections of an unmodified rospy program, secured.

Nothing of ROS is imported before `secure` is called. Judgement is the built-in node's
(`rossec.node`): `topics`, `services`, `slave`, `access`, `links`; here is what fits it to rospy.
"""
