"""Calls at the master: methods, arguments, rights asked, answers. Pure."""
