"""The border router of constrained things (RFC 7228): CoAP, EDHOC, OSCORE; needs the extra `constrained`."""
