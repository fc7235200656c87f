"""Ordinary rospy programs without rossec."""

from typing import Final

BASICS_SERVER: Final = """
import rospy
from std_msgs.msg import String
from std_srvs.srv import SetBool
rospy.init_node("basics")
rospy.set_param("~colour", {"red": [1, 2.5, True]})
rospy.Service("~switch", SetBool, lambda asked: (asked.data, rospy.get_name()))
words = rospy.Publisher("/basics/words", String, queue_size=10)
number = 0
while not rospy.is_shutdown():
    words.publish(f"word {number}")
    number += 1
    rospy.rostime.wallsleep(0.05)
"""

BASICS_CLIENT: Final = """
import rospy
from std_msgs.msg import String
from std_srvs.srv import SetBool
rospy.init_node("asker")
print("HEARD", rospy.wait_for_message("/basics/words", String, timeout=20).data)
rospy.wait_for_service("/basics/switch", timeout=20)
print("ANSWERED", rospy.ServiceProxy("/basics/switch", SetBool)(True).message)
kept = rospy.ServiceProxy("/basics/switch", SetBool, persistent=True)
print("KEPT", [kept(on).success for on in (True, False)])
print("COLOUR", rospy.get_param("/basics/colour/red"))
rospy.set_param("~mine", 7)
print("OWN", rospy.get_param("~mine"), rospy.has_param("~none"), rospy.search_param("mine"))
rospy.delete_param("~mine")
print("DELETED", rospy.get_param("~mine", "gone"))
seen = []
rospy.Subscriber("/basics/words", String, lambda message: seen.append(message.data))
while len(seen) < 5:
    rospy.rostime.wallsleep(0.02)
print("IN ORDER", seen == sorted(seen, key=lambda word: int(word.split()[1])))
"""

ACTION_SERVER: Final = """
import actionlib, rospy
from actionlib.msg import TestAction, TestFeedback, TestResult
rospy.init_node("worker")
def work(goal):
    for step in range(3):
        server.publish_feedback(TestFeedback(step))
        rospy.rostime.wallsleep(0.05)
    while goal.goal >= 100 and not server.is_preempt_requested():
        rospy.rostime.wallsleep(0.02)
    if goal.goal >= 100:
        server.set_preempted(TestResult(-1))
    else:
        server.set_succeeded(TestResult(2 * goal.goal))
server = actionlib.SimpleActionServer("chore", TestAction, work, auto_start=False)
server.start()
print("READY", flush=True)
rospy.spin()
"""

ACTION_CLIENT: Final = """
import actionlib, rospy
from actionlib.msg import TestAction, TestGoal
rospy.init_node("boss")
client = actionlib.SimpleActionClient("chore", TestAction)
print("SERVER", client.wait_for_server(rospy.Duration(20)))
steps = []
client.send_goal(TestGoal(21), feedback_cb=lambda feedback: steps.append(feedback.feedback))
print("FINISHED", client.wait_for_result(rospy.Duration(20)))
print("RESULT", client.get_result().result, client.get_goal_status_text(), steps)
client.send_goal(TestGoal(100), feedback_cb=lambda feedback: client.cancel_goal())
print("FINISHED", client.wait_for_result(rospy.Duration(20)))
print("CANCELLED", client.get_state() == actionlib.GoalStatus.PREEMPTED)
"""

TF_BROADCASTER: Final = """
import rospy, tf2_ros
from geometry_msgs.msg import TransformStamped
rospy.init_node("mount")
def transform(parent, child, x):
    made = TransformStamped()
    made.header.stamp, made.header.frame_id, made.child_frame_id = rospy.Time.now(), parent, child
    made.transform.translation.x, made.transform.rotation.w = x, 1.0
    return made
static = tf2_ros.StaticTransformBroadcaster()
static.sendTransform(transform("base", "camera", 0.5))
moving = tf2_ros.TransformBroadcaster()
print("READY", flush=True)
while not rospy.is_shutdown():
    moving.sendTransform(transform("map", "base", 2.0))
    rospy.rostime.wallsleep(0.05)
"""

TF_LISTENER: Final = """
import rospy, tf2_ros
rospy.init_node("looker")
buffer = tf2_ros.Buffer()
tf2_ros.TransformListener(buffer)
while not buffer.can_transform("map", "camera", rospy.Time(0)):
    rospy.rostime.wallsleep(0.02)
print("CAMERA AT", buffer.lookup_transform("map", "camera", rospy.Time(0)).transform.translation.x)
"""

RECONFIGURE_SERVER: Final = """
import rospy
from dynamic_reconfigure.server import Server
class Speed:  # as the generator writes it from a .cfg file
    defaults, min, max = {"speed": 1.5}, {"speed": 0.0}, {"speed": 3.0}
    config_description = {
        "name": "Default", "id": 0, "parent": 0, "type": "", "state": True, "groups": [],
        "parameters": [{"name": "speed", "type": "double", "level": 1, "description": "in m/s",
                        "edit_method": ""}],
    }
rospy.init_node("drive")
def changed(config, level):
    print("SPEED", config["speed"], flush=True)
    return config
Server(Speed, changed)
print("READY", flush=True)
rospy.spin()
"""

RECONFIGURE_CLIENT: Final = """
import rospy
from dynamic_reconfigure.client import Client
rospy.init_node("tuner")
client = Client("drive", timeout=20)
print("BEFORE", client.get_configuration(timeout=20)["speed"])
print("AFTER", client.update_configuration({"speed": 9.0})["speed"])
"""

MARKERS: Final = """
import rospy
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker
rospy.init_node("painter")
wall = Marker(type=Marker.POINTS, points=[Point(x / 4, y / 4, 0) for x in range(-9, 9)
                                          for y in range(-9, 9)])
wall.header.frame_id, wall.pose.orientation.w, wall.scale.x, wall.scale.y = "camera", 1, 0.2, 0.2
wall.color.r = wall.color.b = wall.color.a = 1.0
paint = rospy.Publisher("/markers", Marker, queue_size=1, latch=True)
paint.publish(wall)
print("READY", flush=True)
rospy.spin()
"""

RQT: Final = """
import dynamic_reconfigure, rosgraph.impl.graph, rosgraph_msgs.msg, rosparam, rospy, rosservice
import rostopic, time
rospy.init_node("rqt_gui_py_node")
# rqt_graph
graph = rosgraph.impl.graph.Graph()
graph.set_master_stale(0.1)
graph.set_node_stale(0.1)
graph.update()
while not any(edge.label == "/chatter" for edge in graph.nn_edges):
    time.sleep(0.2)
    graph.update()
edge = next(edge for edge in graph.nn_edges if edge.label == "/chatter")
print("GRAPH", edge.start, edge.label, edge.end, {edge.start, edge.end} & set(graph.bad_nodes))
print("NODES", "/talker" in graph.nn_nodes, any("/chatter" in name for name in graph.nt_nodes))
# rqt_topic, rqt_plot
types = dict(rosgraph.Master("/rqt_topic").getTopicTypes())
kind, name, _ = rostopic.get_topic_class("/chatter")
print("TOPIC", types["/chatter"], name, rospy.wait_for_message(name, kind, 20).data[:5])
rate = rostopic.ROSTopicHz(-1)
rospy.Subscriber(name, rospy.AnyMsg, rate.callback_hz)
while not (found := rate.get_hz()):
    time.sleep(0.05)
print("HZ", found[0] > 0)
# rqt_service_caller
print("SERVICE", "/talker/say" in rosservice.get_service_list(),
      rosservice.get_service_class_by_name("/talker/say").__name__)
print("PROVIDER", rosservice.get_service_node("/talker/say"))
# rqt_reconfigure
print("RECONFIGURE", dynamic_reconfigure.find_reconfigure_services())
# rqt_console, rqt_logger_level
said = rospy.wait_for_message("/rosout", rosgraph_msgs.msg.Log, 20)
print("ROSOUT", said.name)
# rqt_publisher
once = rospy.Publisher("/aim", rostopic.get_topic_class("/chatter")[0], queue_size=1, latch=True)
once.publish("from rqt")
print("PARAMETERS", sorted(rosparam.list_params("/talker")))
rospy.rostime.wallsleep(0.2)
"""
