"""Masters that follow each other: a mesh of one domain, and masters of foreign domains."""
