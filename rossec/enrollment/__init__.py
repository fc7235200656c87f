"""Enrollment over the network and from pictures: both sides of `docs/spec/enrollment.md`."""

from rossec.enrollment.enroll import WaitingNode, code_in_file, deliver, fetch
from rossec.enrollment.join import DECISION, JoinServer, ask_name
from rossec.enrollment.scanner import CLOSER

__all__ = ["CLOSER", "DECISION", "JoinServer", "WaitingNode", "ask_name", "code_in_file", "deliver", "fetch"]
