"""The gateway: one copy of what another domain sends, for everybody here who may have it."""

from rossec.gateway.gateway import Gateway, status
from rossec.gateway.rules import MAX_RULES, TopicRule, rule

__all__ = ["MAX_RULES", "Gateway", "TopicRule", "rule", "status"]
