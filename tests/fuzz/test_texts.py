"""Invalid texts: XML-RPC's elements in every place, policies with every type, broken rules."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import pytest
from ruamel.yaml import YAML

from ca.errors import HintedError
from rossec.authority.policyfile import parse_policy
from rossec.errors import RossecError
from rossec.naming import examine, requests, rule_runner, xslt
from rossec.naming.requests import NameKind, NameRequest, check_proposed
from rossec.ros import xmlrpc
from tests.fuzz.mutants import mutants
from tests.rossec.namespace.launch_texts import FIGURES, simple, transform

POLICIES: Final = sorted((Path(__file__).parents[2] / "examples" / "policies").glob("*.yaml"))
ELEMENTS: Final = (
    "<int>abc</int>",
    "<int></int>",
    "<i4>99999999999999999999</i4>",
    f"<int>{'9' * 5000}</int>",
    "<double>nan</double>",
    "<double>1e999</double>",
    "<double>x</double>",
    "<boolean>2</boolean>",
    "<base64>!!!</base64>",
    "<base64>A</base64>",
    "<dateTime.iso8601>x</dateTime.iso8601>",
    "<dateTime.iso8601>20260101T00:00:00</dateTime.iso8601>",
    "<nil/>",
    "<ex:nil/>",
    "<i8>5</i8>",
    "<bigdecimal>1</bigdecimal>",
    "<bigdecimal>x</bigdecimal>",
    "<bigdecimal>NaN</bigdecimal>",
    "<struct></struct>",
    "<struct><member></member></struct>",
    "<struct><member><name>a</name></member></struct>",
    "<struct><member><value>b</value><name>a</name></member></struct>",
    "<struct><member><value><int>1</int></value><value>b</value></member></struct>",
    "<struct><member><value><array><data/></array></value><value>b</value></member></struct>",
    "<array></array>",
    "<array><value>1</value></array>",
    "<string>x</string><int>1</int>",
    "<string>&#0;</string>",
    "<string>&#xD800;</string>",
    "<string>&lol;</string>",
    "plain",
    "",
    "<value>x</value>",
    "<params></params>",
    "<methodName>x</methodName>",
    "<fault><value>1</value></fault>",
    "<array><data>" * 70 + "</data></array>" * 70,
    "<!-- x --><int>1</int>",
    "<![CDATA[x]]>",
    "<?x y?>",
    "<int>1</string>",
)
_CALL: Final = "<methodCall><methodName>m</methodName><params>{}</params></methodCall>"
CALLS: Final = (
    _CALL,
    _CALL.format("<param><value>{}</value></param>"),
    "<methodCall>{}</methodCall>",
    "<methodCall><methodName>{}</methodName><params></params></methodCall>",
    _CALL.format("<param><value><array><data><value>{}</value></data></array></value></param>"),
)
_FAULT: Final = "<member><name>{}</name><value>{{0}}</value></member>"
ANSWERS: Final = (
    "<methodResponse>{}</methodResponse>",
    "<methodResponse><params><param><value>{}</value></param></params></methodResponse>",
    "<methodResponse><fault><value>{}</value></fault></methodResponse>",
    "<methodResponse><fault><value><struct>"
    + _FAULT.format("faultCode")
    + _FAULT.format("faultString")
    + "</struct></value></fault></methodResponse>",
)


@pytest.mark.parametrize(("templates", "load"), [(CALLS, xmlrpc.load_call), (ANSWERS, xmlrpc.load_response)])
def test_every_element_of_xml_rpc_in_every_place(
    templates: tuple[str, ...], load: Callable[[bytes], object]
) -> None:
    for template in templates:
        for element in ELEMENTS:
            with suppress(HintedError, xmlrpc.Fault):
                load(template.format(element).encode())


def texts(value: Any) -> Iterator[str]:
    """Changed structures that a text can hold; JSON is YAML."""
    for changed in mutants(value):
        with suppress(TypeError):  # bytes, and what is raw
            yield json.dumps(changed)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("path", POLICIES, ids=lambda path: str(path.stem))
def test_every_type_in_every_place_of_a_policy(path: Path) -> None:
    policy = YAML(typ="safe").load(path.read_text())
    parse_policy(json.dumps(policy), "policy.yaml")
    every = 11 if len(json.dumps(policy)) < 1000 else 101  # by samples: each takes milliseconds
    for number, text in enumerate(texts(policy)):
        if number % every == 0:
            try:
                with suppress(HintedError):
                    parse_policy(text, "policy.yaml")
            except Exception as error:
                raise AssertionError(text[:400]) from error


RULES: Final = rule_runner.shipped_rules()
PHONE: Final = rule_runner.shipped_example("phone.xml")
QUERIES: Final = ((NameKind.NODE, ""), (NameKind.TOPIC, "temperature"))


def broken(text: bytes, every: int) -> Iterator[bytes]:
    """A byte, or some, less or other than it was, at every place or every few."""
    for at in range(0, len(text), every):
        yield text[:at] + text[at + 1 :]
        yield text[:at] + text[at + 17 :]
        for byte in b"<>&'\"/\0\xff]{":
            yield text[:at] + bytes((byte,)) + text[at + 1 :]


def test_metadata_with_every_byte_broken() -> None:
    for text in broken(PHONE, 1):
        with suppress(RossecError):
            requests.read(text)
            list(examine.orders(text))
        with suppress(RossecError):
            requests.read_names(xslt.answer(NameRequest(RULES, text, QUERIES)), len(QUERIES))


def test_rules_with_bytes_broken_at_many_places() -> None:
    for text in broken(RULES, 7):
        with suppress(RossecError):
            requests.read_names(xslt.answer(NameRequest(text, PHONE, QUERIES)), len(QUERIES))


def checked(metadata: bytes, queries: Sequence[tuple[NameKind, str]]) -> list[str]:
    return [check_proposed(name) for name in simple(metadata, queries)]


def other_elements(data: bytes) -> list[tuple[str, set[str]]]:
    """What is neither metadata nor made of them, by tags and attributes."""
    return [
        (element.tag, set(element.keys()) - {"ns"})
        for element in ElementTree.fromstring(data).iter()
        if element.tag != "remap" and not element.tag.startswith("{")
    ]


def test_launch_files_with_every_byte_broken() -> None:
    """One that is not refused is a launch file again, with all that it had beside metadata."""
    figure = (FIGURES / "phones.launch").read_bytes()
    for text in broken(figure, 1):
        with suppress(RossecError):
            made, _ = transform(text, checked)
            assert other_elements(made) == other_elements(text), text
