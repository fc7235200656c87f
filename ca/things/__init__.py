"""Constrained things: what the authority says of them, and the credentials it says it about."""

from ca.things.constrained_nodes import (
    MAX_STATEMENT,
    PSK,
    SECRET_SIZE,
    THING,
    Credential,
    ThingKey,
    ThingSecret,
    ThingStatement,
    check_thing_name,
    peek_statement,
    read_ccs,
    read_description,
    secret_text,
    sign_statement,
    verify_statement,
)

__all__ = [
    "MAX_STATEMENT",
    "PSK",
    "SECRET_SIZE",
    "THING",
    "Credential",
    "ThingKey",
    "ThingSecret",
    "ThingStatement",
    "check_thing_name",
    "peek_statement",
    "read_ccs",
    "read_description",
    "secret_text",
    "sign_statement",
    "verify_statement",
]
