"""Names by rules: metadata of a node become names, by XSLT in a confined process."""
