"""Who a node is: keys, identities, enrollment, revocation, the authority and its store."""
