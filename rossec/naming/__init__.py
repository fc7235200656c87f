"""Names by rules: metadata of a node become names, by XSLT in a confined process."""

from rossec.naming.examine import MetadataReport
from rossec.naming.requests import MAX_INPUT, NameKind, check_document, check_rules
from rossec.naming.rule_runner import RuleRunner, require_extra

__all__ = [
    "MAX_INPUT",
    "MetadataReport",
    "NameKind",
    "RuleRunner",
    "check_document",
    "check_rules",
    "require_extra",
]
