"""EDHOC, RFC 9528: messages, key schedule, suites, credentials. Pure."""
