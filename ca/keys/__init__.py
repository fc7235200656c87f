"""Private and public keys, and what signs with them: files, PKCS#11 tokens, COSE and X.509."""
