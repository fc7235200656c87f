"""What a restriction does to a message: layouts, operators, generated code. Pure."""
