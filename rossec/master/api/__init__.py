"""The Master API: methods, arguments, authorization, answers. Pure."""
