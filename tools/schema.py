"""Write `grants/policy/policy.schema.json` again, after operators or rights have changed."""

from grants.policy import schema

schema.FILE.write_text(schema.text())
