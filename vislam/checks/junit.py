"""A comparison as JUnit XML, which build servers read: one test case a check, and one a run."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from vislam.base.files import replace_whole

_NOT_IN_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot hold, not even escaped."""


def write_junit(path: Path, document: Mapping[str, Any]) -> None:
    """Write a ``metrics.json`` as JUnit XML, whole or not at all.

    A check that does not hold is a failure; a run that did not finish is an error of its test case
    ``completes``.
    """
    root = Xml.Element("testsuites")
    root.append(_suite(document))
    root.attrib.update({"name": "vislam", **{key: root[0].attrib[key] for key in _COUNTED}})
    tree = Xml.ElementTree(root)
    Xml.indent(tree)
    with replace_whole(path) as temporary:
        tree.write(temporary, encoding="utf-8", xml_declaration=True)


_COUNTED = ("tests", "failures", "errors", "time")


def _suite(document: Mapping[str, Any]) -> Xml.Element:
    seconds = {m["estimator"]: m["value"] for m in document["metrics"] if m["key"] == "total_time_s"}
    suite = Xml.Element("testsuite")
    suite.append(_properties(document))
    name = document["name"]
    for estimator, run in document["runs"].items():
        case = _case(suite, "completes", f"{name}.{estimator}", seconds.get(estimator, 0.0))
        if not run["complete"]:
            _mark(case, "error", "incomplete", run["error"])
    for check in document["checks"]:
        case = _case(suite, check["check"], f"{name}.{check['estimator']}", 0.0)
        if check["holds"]:
            Xml.SubElement(case, "system-out").text = _plain(_told(check))
        else:
            _mark(case, "failure", "check", _told(check))
    suite.attrib.update(
        name=_plain(name),
        tests=str(len(suite.findall("testcase"))),
        failures=str(len(suite.findall("testcase/failure"))),
        errors=str(len(suite.findall("testcase/error"))),
        skipped="0",
        time=f"{sum(seconds.values()):.3f}",
    )
    return suite


def _told(check: Mapping[str, Any]) -> str:
    return "; ".join(part for part in (check["measured"], check["convention"]) if part)


def _properties(document: Mapping[str, Any]) -> Xml.Element:
    dataset = document["dataset"]
    known = {
        **{key: dataset[key] for key in ("name", "digest", "synthetic", "reference")},
        **document["provenance"],
    }
    found = Xml.Element("properties")
    for key, value in known.items():
        where = "dataset" if key in dataset else "provenance"
        Xml.SubElement(found, "property", name=f"{where}.{key}", value=_plain(str(value)))
    return found


def _case(suite: Xml.Element, name: str, classname: str, seconds: float) -> Xml.Element:
    return Xml.SubElement(
        suite, "testcase", name=_plain(name), classname=_plain(classname), time=f"{seconds:.3f}"
    )


def _mark(case: Xml.Element, kind: str, why: str, text: str) -> None:
    Xml.SubElement(case, kind, message=_plain(text), type=why).text = _plain(text)


def _plain(text: str) -> str:
    return _NOT_IN_XML.sub("?", text)
