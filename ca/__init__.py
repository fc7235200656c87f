"""Identities of nodes: keys, certificates, enrollment, revocation, the authority and its store."""
