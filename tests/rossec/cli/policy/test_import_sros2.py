from pathlib import Path

from tests.support.commands import Shell, refused

XML = """<policy version="0.2.0"><enclaves><enclave path="/"><profiles>
<profile ns="/" node="talker"><topics publish="ALLOW"><topic>chatter</topic><topic>rt*</topic>
</topics></profile></profiles></enclave></enclaves></policy>"""


def test_an_sros2_policy_is_imported(shell: Shell, tmp_path: Path) -> None:
    xml = tmp_path / "policy.xml"
    xml.write_text(XML)
    said = shell("policy", "import-sros2", str(xml))
    assert "publish: [/chatter]" in said.out
    left = "rossec: left out: /talker: publish /rt* is not a pattern of whole segments\n"
    assert said.err == left
    out = tmp_path / "new.yaml"
    said = shell("policy", "import-sros2", str(xml), "--out", str(out))
    assert said.out == f"written to {out}\n"
    assert shell("policy", "check", str(out)).code == 0
    said = shell("policy", "import-sros2", str(xml), "--out", str(out))
    assert (said.code, "is not overwritten" in said.err) == (1, True)
    xml.write_text('<!DOCTYPE p [<!ENTITY a "b">]><policy>&a;</policy>')
    refused(shell("policy", "import-sros2", str(xml)), "a policy with a DTD is refused")
