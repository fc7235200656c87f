"""Write `grants/policy/policy.schema.json` again, after operators or rights have changed."""

from pathlib import Path

from grants.policy import schema

Path(schema.__file__).with_name("policy.schema.json").write_text(schema.text())
