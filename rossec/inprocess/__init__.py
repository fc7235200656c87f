"""`import rossec; rossec.secure()`: the connections of an unmodified rospy program, secured.

Nothing of ROS is imported before `secure` is called. Handshakes, rights and the slave API are those
of the built-in node (`rossec.participant`); this package connects them to rospy.
"""

from rossec.inprocess.options import file_of, read
from rossec.inprocess.request import ask

__all__ = ["ask", "file_of", "read"]
