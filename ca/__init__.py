"""Who a node is: keys, identities, enrollment, revocation statements, the authority and its store."""
