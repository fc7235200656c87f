"""The commented beginning of a policy, which `rossec policy init` writes. Pure.

It is a valid policy: every node gets what every ROS program needs, and nothing else.
"""

import json
from typing import Final

_TEXT: Final = """\
# Who may do what, how precisely, and how long: docs/spec/policy.md.
#   rossec policy check    every mistake in this file; also runs the tests below
#   rossec policy lint     what it allows unwisely
#   rossec policy apply    shows the difference to what is granted, asks, and puts it in force
rossec: 1
robot: {robot}
basics: true  # what every ROS program needs: its log, its loggers, the clock; [tf]: transforms too
defaults: {{lifetime: 7d}}

# The message type of each topic that a filter or a condition of a rule looks into, as in
#   types: {{/robot/pose: geometry_msgs/PoseStamped}}
types: {{}}

# What no rule allows is denied, and one denial overrides all that allows. Names below the asking
# node's own are ~/pose or "{{node}}/pose"; * is one segment of a name, ** one or more. As in
#   rules:
#     - {{id: pose, who: /robot, allow: {{publish: [~/pose]}}, why: it says where it is}}
#     - id: heating
#       why: lowers empty rooms
#       who: /heating
#       allow: {{subscribe: [/robot/pose]}}
#       see: {{position: room}}
rules: []

# What must stay true whatever is changed above; apply refuses a policy of which one fails. As in
#   tests:
#     - {{who: /heating, may_not: {{publish: /**}}, sees: {{/robot/pose: {{position: room}}}}}}
tests: []
"""


def beginning(robot: str) -> str:
    """The text, for the robot or home of this name."""
    return _TEXT.format(robot=json.dumps(robot))
