"""The secure channel, sans-IO: EDHOC (RFC 9528) and AEAD records."""
