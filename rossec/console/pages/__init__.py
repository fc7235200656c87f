"""The pages, one module each: a table `PAGES`, and functions that answer."""
