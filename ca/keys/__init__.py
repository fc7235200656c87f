"""Private and public keys, and signers: key files, PKCS#11 tokens, X.509."""
