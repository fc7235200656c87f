"""What commands share: environment, options, passphrases, reaching the master."""
