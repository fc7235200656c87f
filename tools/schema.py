"""Write `grants/policy/policy.schema.json` again, after operators or rights have changed."""

from pathlib import Path

from grants.policy import read

Path(read.__file__).with_name("policy.schema.json").write_text(read.schema_text())
