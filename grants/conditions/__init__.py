"""Conditions on time and content: a small language, read and compiled. Pure."""

from grants.conditions.compile import Condition, check_syntax, compile_condition, parse_timestamp
from grants.conditions.syntax import fields_read, reads

__all__ = ["Condition", "check_syntax", "compile_condition", "fields_read", "parse_timestamp", "reads"]
