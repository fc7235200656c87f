"""Secures programs that know nothing of rossec: a loopback master of their own, and a guard."""
